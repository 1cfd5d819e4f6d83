"""Self-Identification and Correction (A-MuSIC, III-A), incremental along diagonals.

A candidate's statistic sums the z-scores on one diagonal of the score matrix. With one running
sum per diagonal, a frame costs one contiguous add of R numbers and K look-ups, however long the
history is. The compiled functions here are the only implementation; the environment
(:mod:`amusic_gym.episode`) and :class:`SIC` both call them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym._compile import apart, compiled, inner
from amusic_gym.rows import RUN, RowBuffer, mean_at, prepare, row_at, scale_at
from amusic_gym.settings import SICSettings

RELATIVE_TIE = 1e-9
ABSOLUTE_TIE = 1e-12
"""Statistics this close to each other are equal."""

SLACK = 512
"""Frames that the running sums move before their window is copied back."""

SUMS = np.dtype(
    [
        ("origin", np.int64),  # place c at frame n has its sum at sums[origin - n + c]
        ("last", np.int64),  # frame of the last row added, -1 before the first
        ("expired", np.int64),  # frames before this one have left the history
        ("since", np.int64),  # the technique ran on every frame from this one to last
    ]
)
"""Bookkeeping of one technique's running sums. Float64[R + SLACK] sums go with it."""


@inner
def add_row(sums: Any, base: int, run: Any, frame: int, decay: float) -> None:
    """Multiply the window's R sums by ``decay`` and add the frame's z-scores."""
    prepare(run, frame)  # again in an unpickled environment, whose bank starts unprepared
    row = row_at(run, frame)
    mean = mean_at(run, frame)[0]
    scale = scale_at(run, frame)[0]
    window = sums[base : base + row.size]
    if decay == 1.0:
        for place in range(row.size):
            window[place] += (row[place] - mean) * scale
    else:
        for place in range(row.size):
            window[place] = decay * window[place] + (row[place] - mean) * scale


@apart
def remove_row(sums: Any, base: int, run: Any, frame: int, age: int, weight: float) -> None:
    """Take a frame's z-scores, ``age`` frames old, out of the sums of their diagonals."""
    prepare(run, frame)  # as in add_row
    row = row_at(run, frame)
    mean = mean_at(run, frame)[0]
    scale = scale_at(run, frame)[0] * weight
    for place in range(row.size - age):
        sums[base + age + place] -= (row[place] - mean) * scale


@apart
def recentre(sums: Any, mark: Any, frame: int, size: int) -> None:
    """Move the window of R sums to the right end when the next frame would leave the left one.

    Sums of diagonals that begin after ``mark.last`` are zero: nothing was added to them.
    """
    base = mark.origin - frame
    if base >= 0:
        return
    room = sums.size - size
    kept = size + base  # the window reaches -base places beyond the left end
    for place in range(kept - 1, -1, -1):
        sums[room - base + place] = sums[place]
    for index in range(min(room - base, sums.size)):
        sums[index] = 0.0
    mark.origin = frame + room


@compiled
def push(sums: Any, mark: Any, run: Any, ran: Any, frame: int, history: int, gamma: float) -> None:
    """Add the row of ``frame`` to the running sums and let rows older than F frames go.

    Args:
        sums: (R + SLACK,) float64.
        mark: SUMS record.
        run: RUN record; its row of ``frame`` is prepared.
        ran: (Q,) uint8, the frames that the technique ran on.
        frame: frame index n, later than ``mark.last``.
        history: F.
        gamma: weight of a row per frame of age.
    """
    recentre(sums, mark, frame, run.references)
    base = mark.origin - frame
    decay = 1.0 if gamma == 1.0 or mark.last < 0 else gamma ** (frame - mark.last)
    add_row(sums, base, run, frame, decay)
    while mark.expired < frame - history:
        age = frame - mark.expired
        # A row that came and went within one gap was never added, or has left the map.
        if ran[mark.expired] and mark.expired <= mark.last and age < run.references:
            remove_row(sums, base, run, mark.expired, age, gamma**age)
        mark.expired += 1
    if frame != mark.last + 1:
        mark.since = frame
    mark.last = frame


@compiled
def weigh(prefix: Any, ran: Any, first: int, stop: int, ratio: float) -> None:
    """Extend the prefix weights: ``prefix[p + 1]`` = Σ ratio^(p−i) over the frames i ≤ p that ran.

    ``ratio`` is γ² for evidence and γ for mean; ``prefix`` is (Q + 1,) and starts with 0.
    """
    for frame in range(first, stop):
        prefix[frame + 1] = ratio * prefix[frame] + ran[frame]


@compiled
def ratio_of(gamma: float, evidence: bool) -> float:
    """What the weights of two neighbouring frames differ by: γ² in Σw², γ in Σw."""
    return gamma * gamma if evidence else gamma


@inner
def weight_of(prefix: Any, frame: int, place: int, history: int, ratio: float) -> float:
    """Σw² (evidence) or Σw (mean) of the frames that count for a candidate.

    The walk back stops at the start of the history, of the run or of the map, whichever is
    nearest.
    """
    span = min(history, frame, place)
    before = prefix[frame - span]
    if ratio != 1.0:
        before *= ratio ** (span + 1)
    weight: float = prefix[frame + 1] - before
    return weight


@inner
def statistic_of(total: float, weight: float, evidence: bool) -> float:
    """Statistic of a diagonal's sum: Σwz/√Σw² (evidence) or Σwz/Σw (mean)."""
    return total / math.sqrt(weight) if evidence else total / weight


@compiled
def score_candidates(
    sums: Any,
    mark: Any,
    top: Any,
    prefix: Any,
    frame: int,
    history: int,
    gamma: float,
    evidence: bool,
    weights: Any,
    out: Any,
) -> None:
    """Write the statistics of the candidates ``top`` (K,) at ``frame`` to ``out`` (K,).

    Look-ups first, arithmetic after: the second loop has no scattered access and runs in SIMD.
    ``weights`` (K,) is scratch.
    """
    window = sums[mark.origin - frame :]
    ratio = ratio_of(gamma, evidence)
    reach = min(history, frame)
    if ratio == 1.0 and frame - reach >= mark.since:
        # It ran on every frame that counts: the weights need no look-up.
        for rank in range(top.size):
            out[rank] = window[np.uintp(top[rank])]  # unsigned: no check for a negative index
            weights[rank] = min(reach, top[rank]) + 1.0
    else:
        for rank in range(top.size):
            out[rank] = window[np.uintp(top[rank])]
            weights[rank] = weight_of(prefix, frame, top[rank], history, ratio)
    if evidence:
        for rank in range(top.size):
            out[rank] = statistic_of(out[rank], weights[rank], True)
    else:
        for rank in range(top.size):
            out[rank] = statistic_of(out[rank], weights[rank], False)


@inner
def tie(best: float) -> float:
    """How far below ``best`` a statistic still counts as equal."""
    return ABSOLUTE_TIE + RELATIVE_TIE * abs(best)


@inner
def highest(values: Any, size: int) -> float:
    """Largest of the first ``size`` values.

    In four lanes, here and in :func:`best_rival`: comparisons of one chain wait for each other.
    """
    a, b, c, d = values[0], -math.inf, -math.inf, -math.inf
    even = size - size % 4
    for i in range(0, even, 4):
        a = values[i] if values[i] > a else a
        b = values[i + 1] if values[i + 1] > b else b
        c = values[i + 2] if values[i + 2] > c else c
        d = values[i + 3] if values[i + 3] > d else d
    for i in range(even, size):
        a = values[i] if values[i] > a else a
    best: float = max(max(a, b), max(c, d))
    return best


@compiled
def first_best(values: Any, size: int) -> int:
    """Index of the highest of ``values``; of equal ones the first."""
    best = highest(values, size)
    floor = best - tie(best)
    for i in range(size):
        if values[i] >= floor:
            return i
    return 0


@inner
def value_beyond(values: Any, top: Any, rank: int, place: int, tolerance: int) -> float:
    """Statistic of a candidate beyond ``tolerance`` of ``place``; −∞ for one within it."""
    value: float = values[rank] if abs(top[rank] - place) > tolerance else -math.inf
    return value


@inner
def best_rival(values: Any, top: Any, size: int, place: int, tolerance: int, best: float) -> float:
    """Highest of ``best`` and the statistics of candidates beyond ``tolerance`` of ``place``."""
    a, b, c, d = best, -math.inf, -math.inf, -math.inf
    even = size - size % 4
    for i in range(0, even, 4):
        a = max(a, value_beyond(values, top, i, place, tolerance))
        b = max(b, value_beyond(values, top, i + 1, place, tolerance))
        c = max(c, value_beyond(values, top, i + 2, place, tolerance))
        d = max(d, value_beyond(values, top, i + 3, place, tolerance))
    for i in range(even, size):
        a = max(a, value_beyond(values, top, i, place, tolerance))
    return max(max(a, b), max(c, d))


class Match(NamedTuple):
    """What SIC says of one frame.

    Attributes:
        place: the corrected match, an index into the map.
        statistic: its statistic (in standard deviations of the technique's scores).
        correction: its statistic less that of the uncorrected match, ≥ 0.
    """

    place: int
    statistic: float
    correction: float


@dataclass
class _History:
    """Rows of the frames so far and what the kernels need of them; room for C frames."""

    buffer: RowBuffer
    ran: NDArray[np.uint8]  # (C,)
    prefix: NDArray[np.float64]  # (C + 1,) prefix weights

    @classmethod
    def empty(cls, capacity: int, references: int, candidates: int) -> _History:
        """Room for ``capacity`` frames."""
        buffer = RowBuffer.empty(capacity, references, candidates)
        return cls(buffer, np.zeros(capacity, np.uint8), np.zeros(capacity + 1))

    def grown(self) -> _History:
        """The same with twice the room."""
        room = len(self.ran)
        ran, prefix = np.pad(self.ran, (0, room)), np.pad(self.prefix, (0, room))
        return _History(self.buffer.grown(2 * room), ran, prefix)

    def run(self) -> Any:
        """RUN record of these rows."""
        run = np.zeros(1, RUN)
        self.buffer.point(run)
        return run[0]


class SIC:
    """Corrects one technique frame by frame (A-MuSIC, III-A).

    Args:
        references: R, places of the map.
        settings: statistic, K, F and γ; by default those of ``evidence``.

    Example:
        >>> sic = SIC(references=3)
        >>> sic.correct([0.1, 0.9, 0.2]).place
        1

    Raises:
        ValueError: for a map without places, and for the statistic ``belief``, which no technique
            has by itself.
    """

    def __init__(self, references: int, settings: SICSettings | None = None) -> None:
        if references < 1:
            raise ValueError(f"references is {references}; a map has at least one place")
        self.settings = settings or SICSettings(statistic="evidence")
        if self.settings.statistic == "belief":
            raise ValueError(
                "statistic is 'belief', which all techniques share, but SIC corrects one alone;"
                " give 'evidence' or 'mean', or take TechniqueSelectionEnv(statistic='belief')"
            )
        self.references = references
        self.frame = -1
        self._history = _History.empty(64, references, self.settings.candidates)
        self._sums: NDArray[np.float64] = np.zeros(references + SLACK)
        self._mark = np.zeros(1, SUMS)
        self._mark["last"] = -1
        self._mark["origin"] = SLACK

    def skip(self) -> None:
        """Let a frame pass on which the technique does not run."""
        self._weigh(self._advance())

    def correct(self, row: ArrayLike) -> Match:
        """Take the technique's scores (R,) of the next frame and return the corrected match.

        Raises:
            ValueError: for scores of the wrong shape, or NaN or infinite ones.
        """
        scores = self._checked(row)
        frame = self._advance()
        self._history.buffer.put(frame, scores)
        self._history.ran[frame] = 1
        return self._match(frame)

    def preview(self, row: ArrayLike) -> Match:
        """What :meth:`correct` would return for the next frame, without taking it."""
        saved = (self.frame, self._sums.copy(), self._mark.copy())
        match = self.correct(row)
        self._history.ran[self.frame] = 0
        self.frame, self._sums, self._mark = saved
        return match

    def _checked(self, row: ArrayLike) -> NDArray[np.float32]:
        scores = np.asarray(row, dtype=np.float32)
        if scores.shape != (self.references,):
            raise ValueError(
                f"a score row of shape {scores.shape} for a map of {self.references} places;"
                f" give one score per place"
            )
        if not np.isfinite(scores).all():
            raise ValueError(f"NaN or infinite score at frame {self.frame + 1}; mend the technique")
        return scores

    def _advance(self) -> int:
        self.frame += 1
        if self.frame >= len(self._history.ran):
            self._history = self._history.grown()
        return self.frame

    def _weigh(self, frame: int) -> None:
        rows = self._history
        ratio = ratio_of(self.settings.gamma, self.settings.statistic == "evidence")
        weigh(rows.prefix, rows.ran, frame, frame + 1, ratio)

    def _match(self, frame: int) -> Match:
        settings, rows, mark = self.settings, self._history, self._mark[0]
        evidence = settings.statistic == "evidence"
        run, history, gamma = rows.run(), settings.history, settings.gamma
        prepare(run, frame)
        push(self._sums, mark, run, rows.ran, frame, history, gamma)
        self._weigh(frame)
        top, prefix = rows.buffer.top[frame], rows.prefix
        values, scratch = np.empty((2, top.size))
        score_candidates(
            self._sums, mark, top, prefix, frame, history, gamma, evidence, scratch, values
        )
        winner = first_best(values, values.size)
        return Match(int(top[winner]), float(values[winner]), float(values[winner] - values[0]))
