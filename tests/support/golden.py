"""A bank small enough to be worked out by hand: 3 techniques, 5 queries, 6 places.

Query q is at place q. Every score row is `offset + sigma * z` with whole z-scores whose sum is 0
and whose squares add up to 6, so that its mean is the offset and its deviation is sigma. Row 3 of
B is constant, so its z-scores are zeros. K is 3 throughout; F and gamma are 1000 and 1 unless
said. Every value is written as the sum it comes from: (now + one frame ago + ...) / terms for the
mean, the same sum / sqrt(terms) for the evidence.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

TECHNIQUES = ("A", "B", "C")
SECONDS = (1.0, 2.0, 4.0)
CANDIDATES = 3
TOLERANCE = 1

Z = {
    "A": [
        [2, -1, -1, 0, 0, 0],
        [0, 0, -1, -1, 2, 0],
        [1, 0, 1, -2, 0, 0],
        [-1, -1, -1, 1, 1, 1],
        [0, 2, -1, -1, 0, 0],
    ],
    "B": [
        [-1, 2, -1, 0, 0, 0],
        [0, 1, -2, 0, 1, 0],
        [-1, -1, 2, 0, 0, 0],
        [0, 0, 0, 0, 0, 0],
        [-1, 0, 0, -1, 2, 0],
    ],
    "C": [
        [1, 1, 1, -1, -1, -1],
        [-1, 2, -1, 0, 0, 0],
        [0, 0, 0, 1, 1, -2],
        [0, -1, -1, 0, 0, 2],
        [1, 0, 0, -2, 1, 0],
    ],
}

_SCALES = {"A": (0, 1), "B": (10, 2), "C": (-5, 3)}  # offset, sigma

SCORES = np.array(
    [
        [[offset + sigma * z for z in row] for row in Z[name]]
        for name, (offset, sigma) in _SCALES.items()
    ],
    dtype=np.float32,
)  # (3, 5, 6)

GROUND_TRUTH = np.eye(5, 6, dtype=bool)  # (5, 6)

# (technique, frame) -> candidates in rank order, the sum of z-scores of each, its terms.
WALKS: dict[tuple[str, int], tuple[list[int], list[int], list[int]]] = {
    # frame 0: nothing to walk back to
    ("A", 0): ([0, 3, 4], [2, 0, 0], [1, 1, 1]),
    ("B", 0): ([1, 3, 4], [2, 0, 0], [1, 1, 1]),
    ("C", 0): ([0, 1, 2], [1, 1, 1], [1, 1, 1]),
    # frame 1; place 0 has no past. A: places 4 and 1 tie under both statistics, 4 ranks better.
    ("A", 1): ([4, 0, 1], [2 + 0, 0, 0 + 2], [2, 1, 2]),
    ("B", 1): ([1, 4, 0], [1 - 1, 1 + 0, 0], [2, 2, 1]),
    ("C", 1): ([1, 3, 4], [2 + 1, 0 + 1, 0 - 1], [2, 2, 2]),
    # frame 2. A: places 0 and 2 tie in the mean, not in the evidence.
    ("A", 2): ([0, 2, 1], [1, 1 + 0 + 2, 0 + 0], [1, 3, 2]),
    ("B", 2): ([2, 3, 4], [2 + 1 - 1, 0 - 2 + 2, 0 + 0 - 1], [3, 3, 3]),
    ("C", 2): ([3, 4, 0], [1 - 1 + 1, 1 + 0 + 1, 0], [3, 3, 1]),
    # frame 3. B's row is constant: every place ties, the lowest three are the candidates.
    ("A", 3): (
        [3, 4, 5],
        [1 + 1 + 0 + 2, 1 - 2 - 1 - 1, 1 + 0 - 1 - 1],
        [4, 4, 4],
    ),
    ("B", 3): ([0, 1, 2], [0, 0 - 1, 0 - 1 + 0], [1, 2, 3]),
    ("C", 3): ([5, 0, 3], [2 + 1 + 0 + 1, 0, 0 + 0 + 2 + 1], [4, 1, 4]),
    # frame 4
    ("A", 4): ([1, 0, 4], [2 - 1, 0, 0 + 1 + 1 + 0 + 2], [2, 1, 5]),
    ("B", 4): ([4, 1, 2], [2 + 0 + 2 + 1 - 1, 0 + 0, 0 + 0 - 1], [5, 2, 3]),
    ("C", 4): ([0, 4, 1], [1, 1 + 0 + 0 + 2 + 1, 0 + 0], [1, 5, 2]),
}

# statistic -> technique -> (winner's place, its statistic, correction) per frame
SIC = {
    "mean": {
        "A": [(0, 2, 0), (4, 2 / 2, 0), (0, 1, 0), (3, 4 / 4, 0), (4, 4 / 5, 4 / 5 - 1 / 2)],
        "B": [(1, 2, 0), (4, 1 / 2, 1 / 2), (2, 2 / 3, 0), (0, 0, 0), (4, 4 / 5, 0)],
        "C": [(0, 1, 0), (1, 3 / 2, 0), (4, 2 / 3, 2 / 3 - 1 / 3), (5, 4 / 4, 0), (0, 1, 0)],
    },
    "evidence": {
        "A": [
            (0, 2, 0),
            (4, 2 / sqrt(2), 0),
            (2, 3 / sqrt(3), 3 / sqrt(3) - 1),
            (3, 4 / sqrt(4), 0),
            (4, 4 / sqrt(5), 4 / sqrt(5) - 1 / sqrt(2)),
        ],
        "B": [
            (1, 2, 0),
            (4, 1 / sqrt(2), 1 / sqrt(2)),
            (2, 2 / sqrt(3), 0),
            (0, 0, 0),
            (4, 4 / sqrt(5), 0),
        ],
        "C": [
            (0, 1, 0),
            (1, 3 / sqrt(2), 0),
            (4, 2 / sqrt(3), 2 / sqrt(3) - 1 / sqrt(3)),
            (5, 4 / sqrt(4), 0),
            (4, 4 / sqrt(5), 4 / sqrt(5) - 1),
        ],
    },
}

# statistic -> (technique, place, confidence, margin) per frame, all three techniques running.
# Equal techniques: A before B at frame 0 (2 each), A before C at frame 3; with the evidence all
# three at frame 4. The margin is that over the best candidate more than TOLERANCE places away.
MUSIC = {
    "mean": [
        (0, 0, 2, 2 - 1),  # rival: C at 2
        (2, 1, 3 / 2, 3 / 2 - 1),  # rival: A at 4
        (0, 0, 1, 1 - 1),  # rival: A at 2
        (0, 3, 1, 1 - 1),  # rival: C at 5
        (2, 0, 1, 1 - 4 / 5),  # rivals: all at 4
    ],
    "evidence": [
        (0, 0, 2, 2 - 1),  # rival: C at 2
        (2, 1, 3 / sqrt(2), 3 / sqrt(2) - 2 / sqrt(2)),  # rival: A at 4
        (0, 2, 3 / sqrt(3), 3 / sqrt(3) - 2 / sqrt(3)),  # rival: C at 4
        (0, 3, 2, 2 - 2),  # rival: C at 5
        (0, 4, 4 / sqrt(5), 4 / sqrt(5) - 1),  # rival: C at 0
    ],
}

# Z-score that the chosen technique's own row gives to MuSIC's place, from Z above.
SIMILARITIES = {"mean": [2, 2, 1, 1, 1], "evidence": [2, 2, 1, 1, 0]}

# A at frame 4 with other settings: (F, gamma, frames it ran on) ->
# statistic -> (winner's place, its statistic, correction). Candidates are 1, 0, 4 as above.
OTHER_SETTINGS = {
    # two past frames: place 1 has 2 - 1, place 4 has 0 + 1 + 1
    (2, 1.0, (1, 1, 1, 1, 1)): {
        "mean": (4, 2 / 3, 2 / 3 - 1 / 2),
        "evidence": (4, 2 / sqrt(3), 2 / sqrt(3) - 1 / sqrt(2)),
    },
    # no past: the row itself
    (0, 1.0, (1, 1, 1, 1, 1)): {"mean": (1, 2, 0), "evidence": (1, 2, 0)},
    # weights 1, 1/2, 1/4, ...: place 1 has 2 - 1/2, place 4 has 0 + 1/2 + 1/4 + 0 + 2/16
    (1000, 0.5, (1, 1, 1, 1, 1)): {
        "mean": (1, (2 - 1 / 2) / (1 + 1 / 2), 0),
        "evidence": (1, (2 - 1 / 2) / sqrt(1 + 1 / 4), 0),
    },
    # without frame 3 nothing speaks against place 1; place 4 has 0 + 1 + 0 + 2
    (1000, 1.0, (1, 1, 1, 0, 1)): {"mean": (1, 2, 0), "evidence": (1, 2, 0)},
    # without frame 1, whose z-score for place 4 is 0: 0 + 1 + 1 + 2 in four terms
    (1000, 1.0, (1, 0, 1, 1, 1)): {
        "mean": (4, 4 / 4, 4 / 4 - 1 / 2),
        "evidence": (4, 4 / sqrt(4), 4 / sqrt(4) - 1 / sqrt(2)),
    },
}

# A-MuSIC with the mean, blocks of M = 2.
AMUSIC_BLOCK = 2

# E = 0.5, alpha = 0.05. Frames 0 and 1 choose A and C once each: A alone reaches ceil(0.5 * 2).
# Its corrections are 0, 0 and then 0, 0: no rejection.
AMUSIC_QUIET = {
    "predictions": [0, 1, 0, 3, 4],
    "confidences": [2, 3 / 2, 1, 1, 4 / 5],
    "ran": [[1, 1, 1], [1, 1, 1], [1, 0, 0], [1, 0, 0], [1, 0, 0]],
    "selections": [(2, [1, 0, 1], [0], [0, 0, 0])],  # before frame, tally, chosen, late runs
    "reselections": 0,
    "runs": [5, 2, 2],
    "ptr": 9 / 15,
    "compute": (5 * 1 + 2 * 2 + 2 * 4) / (5 * 7),
}

# E = 1, alpha = 0.5. A and C run on. A's corrections stay 0; C's go from 0, 0 to 1/3, 0. The
# differences 0, 0, 1/3, 0 have mean 1/12 and deviation 1/6, so t = (1/12) / (1/6 / sqrt(4)) = 1
# with three degrees of freedom, whose two-sided p is 2/3 - sqrt(3) / (2 pi) = 0.391. Rejected:
# B runs on frames 2 and 3 after the fact, A is chosen on both (on frame 3 by the tie with C).
AMUSIC_RESELECTING = {
    "predictions": [0, 1, 0, 3, 4],
    "confidences": [2, 3 / 2, 1, 1, 4 / 5],
    "ran": [[1, 1, 1], [1, 1, 1], [1, 0, 1], [1, 0, 1], [1, 0, 0]],
    "selections": [(2, [1, 0, 1], [0, 2], [0, 0, 0]), (4, [2, 0, 0], [0], [0, 2, 0])],
    "p_value": 2 / 3 - sqrt(3) / (2 * pi),
    "corrections": [[0, 0, 1 / 3], [0, 0, 0]],  # (M, T) of the second selection
    "reselections": 1,
    "runs": [5, 4, 4],
    "ptr": 13 / 15,
    "compute": (5 * 1 + 4 * 2 + 4 * 4) / (5 * 7),
}

# MuSIC's mean: right, right, wrong, right, wrong with confidences 2, 3/2, 1, 1, 1. Precision is
# 1/1, 2/2, 3/5 at the three thresholds. The similarities 2, 2, 1, 1, 1 have the last two of these.
# The evidence is right on all five.
METRICS = {
    "mean": {
        "accuracy": 3 / 5,
        "auc": 2 / 5 * 1 + 1 / 5 * (1 + 3 / 5) / 2,  # recall 1/5, 2/5, 3/5
        "auc_vprbench": 2 / 3 * 1 + 1 / 3 * (1 + 3 / 5) / 2,  # recall 1/3, 2/3, 1
        "auc_paper": 2 / 3 * 1 + 1 / 3 * (1 + 3 / 5) / 2,  # recall 2/3, 1
    },
    "evidence": {"accuracy": 1, "auc": 1, "auc_vprbench": 1, "auc_paper": 1},
}
