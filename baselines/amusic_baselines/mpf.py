"""Multi-Process Fusion: all techniques on every frame, the one that disagrees left out, Viterbi.

Hausler, Jacobson, Milford: Multi-Process Fusion, RA-L 4(2), 2019, and the program its authors
published. Our reading where these leave it open, or where a route here differs from theirs:

 - Equal agreement or equal observations: the lower technique index, the lower place.
 - A frame's quality is the ratio of the best summed logarithm to the next one outside ±R, in (0, 1]
   and the smaller the better; 0 where the whole map lies within ±R. The sequence begins at the
   greatest fall of that ratio if it is at least 0.1.
 - They answer from the 21st frame on, we from the first, with as many frames as there are. So the
   confidence is 1 minus the *mean* ratio along the path; they sum over all frames but the first.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import whole
from amusic_baselines.scores import RADIUS, rows_of, scaled
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy

EPSILON = 0.001  # of an observation that says nothing, and of a move that is not expected
THRESHOLD = 0.5  # below it an observation says nothing
FASTEST = 5  # places forward per frame that are expected at most; none backward
LONGEST, SHORTEST = 20, 5  # frames of a sequence
FALL = 0.1  # of the quality ratio between two frames, at which a sequence begins anew


def observations(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scores (T, R) as observations in [0.001, 0.999]; a constant row says nothing anywhere."""
    seen = scaled(rows) - EPSILON
    return np.where(seen < THRESHOLD, EPSILON, seen)


def dissenter(seen: NDArray[np.float64], radius: int) -> int | None:
    """Index of the technique to leave out of a frame's observations (T, R); None: keep all."""
    best = seen.argmax(axis=1)  # (T,)
    agreement = (np.abs(best[:, None] - best) <= radius).sum(axis=1) - 1  # (T,) besides itself
    if not agreement.any() or (agreement == len(seen) - 1).all():
        return None
    leader = int(agreement.argmax())
    support = seen[:, best[leader]].copy()
    support[leader] = np.inf
    return int(support.argmin())


def ratio(values: NDArray[np.float64], place: int, radius: int) -> float:
    """Value at ``place`` over the best outside ±radius, of negative values (R,); smaller: surer."""
    sides = values[: max(0, place - radius)], values[place + radius + 1 :]
    rivals = [float(side.max()) for side in sides if side.size]
    return float(values[place]) / max(rivals) if rivals else 0.0


def sequence_start(ratios: list[float]) -> int:
    """Where in the window the sequence begins, so that at least `SHORTEST` frames are left."""
    falls = -np.diff(ratios[: len(ratios) - SHORTEST + 1])
    if len(ratios) <= SHORTEST or falls.max() < FALL:
        return 0
    return int(falls.argmax()) + 1


def viterbi(emissions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Logarithms (L, R) of the best paths through log emissions (L, R), and the best one (L,)."""
    unexpected = math.log(EPSILON)
    values = emissions.copy()
    for before, now in zip(values[:-1], values[1:], strict=True):
        arrival = np.maximum(before, before.max() + unexpected)
        for step in range(1, min(FASTEST, before.size - 1) + 1):
            np.maximum(arrival[step:], before[:-step], out=arrival[step:])
        now += arrival
    path = np.zeros(len(values), np.int64)
    path[-1] = values[-1].argmax()
    for frame in range(len(values) - 1, 0, -1):
        place = path[frame]
        arrival = values[frame - 1] + unexpected
        expected = slice(max(0, place - FASTEST), place + 1)
        arrival[expected] = values[frame - 1, expected]
        path[frame - 1] = arrival.argmax()
    return values, path


@dataclass(eq=False)
class MultiProcessFusion:
    """Runs everything; the place is the end of the likeliest path through the last frames."""

    radius: int = RADIUS  # R, places to either side that count as the same match

    def reset(self, references: int, techniques: int) -> None:
        """Forget the last frames."""
        self._techniques = techniques
        self._emissions: deque[NDArray[np.float64]] = deque(maxlen=LONGEST)  # (R,) each
        self._ratios: deque[float] = deque(maxlen=LONGEST)

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """End of the best path; 1 minus the mean quality ratio along it."""
        seen = observations(rows_of(run, range(self._techniques)))
        logs = np.log(seen)
        out = dissenter(seen, self.radius)
        emission = (logs if out is None else np.delete(logs, out, axis=0)).sum(axis=0)  # (R,)
        self._emissions.append(emission)
        self._ratios.append(ratio(emission, int(emission.argmax()), self.radius))
        start = sequence_start(list(self._ratios))
        values, path = viterbi(np.stack(list(self._emissions)[start:]))
        ratios = [ratio(v, int(p), self.radius) for v, p in zip(values, path, strict=True)]
        return int(path[-1]), 1.0 - float(np.mean(ratios))


def mpf(argument: str | None, context: Context) -> MultiProcessFusion:
    """``mpf`` or ``mpf:R``, R places to either side of a match being the same one."""
    if argument is None:
        return MultiProcessFusion()
    return MultiProcessFusion(whole("mpf", argument, "R", argument, 0, 1_000_000))


POLICY = RegisteredPolicy("mpf", mpf, PEER, "MPF", colour="#AA3377", marker="<", constant=True)
