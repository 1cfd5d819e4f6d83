"""Self-Identification and Correction (A-MuSIC, III-A), incremental along diagonals.

A candidate's statistic sums the z-scores on one diagonal of the score matrix. With one running
sum per diagonal, a frame costs one contiguous add of R numbers and K look-ups, however long the
history is. The compiled functions here are the only implementation; the environment
(:mod:`amusic_gym.episode`) and :class:`SIC` both call them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import carray
from numpy.typing import ArrayLike, NDArray

from amusic_gym._compile import compiled, inner, pointer
from amusic_gym.settings import SICSettings

RELATIVE_TIE = 1e-9
ABSOLUTE_TIE = 1e-12
"""Statistics this close to each other are equal."""

SLACK = 512
"""Frames that the running sums move before their window is copied back."""

RUN = np.dtype(
    [
        ("scores", np.int64),  # address of the technique's (Q, R) float32 scores
        ("mean", np.int64),  # addresses of PreparedRows' entries of this technique
        ("scale", np.int64),
        ("top", np.int64),
        ("ready", np.int64),
        ("start", np.int64),  # the query that is frame 0
        ("references", np.int64),  # R
        ("candidates", np.int64),  # K, clipped to R
    ]
)
"""Where one technique's rows lie in memory."""

SUMS = np.dtype(
    [
        ("origin", np.int64),  # place c at frame n has its sum at sums[origin - n + c]
        ("last", np.int64),  # frame of the last row added, -1 before the first
        ("expired", np.int64),  # frames before this one have left the history
    ]
)
"""Bookkeeping of one technique's running sums. Float64[R + SLACK] sums go with it."""


@inner
def row_at(run: Any, frame: int) -> Any:
    """Score row (R,) of a frame."""
    size = run.references
    return carray(pointer(run.scores + (run.start + frame) * size * 4), (size,), np.float32)


@inner
def mean_at(run: Any, frame: int) -> Any:
    """Mean of a frame's row."""
    return carray(pointer(run.mean + (run.start + frame) * 8), (1,), np.float64)


@inner
def scale_at(run: Any, frame: int) -> Any:
    """1/σ of a frame's row."""
    return carray(pointer(run.scale + (run.start + frame) * 8), (1,), np.float64)


@inner
def top_at(run: Any, frame: int) -> Any:
    """Candidates (K,) of a frame, ranked."""
    size = run.candidates
    return carray(pointer(run.top + (run.start + frame) * size * 4), (size,), np.int32)


@inner
def ready_at(run: Any, frame: int) -> Any:
    """Whether the entries of a frame's row are filled."""
    return carray(pointer(run.ready + (run.start + frame)), (1,), np.uint8)


@inner
def worse(scores: Any, a: int, b: int) -> bool:
    """Whether place ``a`` ranks behind place ``b``: lower score, or equal and of higher index."""
    return scores[a] < scores[b] or (scores[a] == scores[b] and a > b)  # type: ignore[no-any-return]


@inner
def sift(scores: Any, heap: Any, root: int, size: int) -> None:
    """Restore a heap of places whose root is the worst."""
    while True:
        child = 2 * root + 1
        if child >= size:
            return
        if child + 1 < size and worse(scores, heap[child + 1], heap[child]):
            child += 1
        if not worse(scores, heap[child], heap[root]):
            return
        heap[root], heap[child] = heap[child], heap[root]
        root = child


@compiled
def rank_candidates(scores: Any, top: Any) -> None:
    """Fill ``top`` (K,) with the best places of ``scores`` (R,), ranked, ties to the lower."""
    size = top.size
    for i in range(size):
        top[i] = i
    for i in range(size // 2 - 1, -1, -1):
        sift(scores, top, i, size)
    for place in range(size, scores.size):
        if scores[place] > scores[top[0]]:
            top[0] = place
            sift(scores, top, 0, size)
    for end in range(size - 1, 0, -1):
        top[0], top[end] = top[end], top[0]
        sift(scores, top, 0, end)


@compiled
def prepare(run: Any, frame: int) -> bool:
    """Fill mean, scale and candidates of a frame's row once; False if a score is not finite."""
    ready = ready_at(run, frame)
    if ready[0]:
        return True
    row = row_at(run, frame)
    total = 0.0
    lowest = row[0]
    highest = row[0]
    for place in range(row.size):
        total += row[place]
        lowest = min(lowest, row[place])
        highest = max(highest, row[place])
    if not math.isfinite(total):
        return False
    mean = total / row.size
    square = 0.0
    for place in range(row.size):
        square += (row[place] - mean) ** 2
    mean_at(run, frame)[0] = mean
    # Asked of the extremes, because rounding can leave a constant row a σ that is not quite 0.
    scale_at(run, frame)[0] = 0.0 if highest == lowest else 1.0 / math.sqrt(square / row.size)
    rank_candidates(row, top_at(run, frame))
    ready[0] = 1
    return True


@inner
def add_row(sums: Any, base: int, run: Any, frame: int, decay: float) -> None:
    """Multiply the window's R sums by ``decay`` and add the frame's z-scores."""
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


@inner
def remove_row(sums: Any, base: int, run: Any, frame: int, age: int, weight: float) -> None:
    """Take a frame's z-scores, ``age`` frames old, out of the sums of their diagonals."""
    row = row_at(run, frame)
    mean = mean_at(run, frame)[0]
    scale = scale_at(run, frame)[0] * weight
    for place in range(row.size - age):
        sums[base + age + place] -= (row[place] - mean) * scale


@inner
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
def push(
    sums: Any, mark: Any, run: Any, ran: Any, frame: int, history: int, gamma: float
) -> None:
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
    mark.last = frame


@compiled
def weigh(weights: Any, squares: Any, ran: Any, first: int, stop: int, gamma: float) -> None:
    """Extend the prefix weights: ``weights[p + 1]`` = Σ γ^(p−i) over the frames i ≤ p that ran.

    ``squares`` likewise with γ². Both are (Q + 1,) and start with 0.
    """
    for frame in range(first, stop):
        weights[frame + 1] = gamma * weights[frame] + ran[frame]
        squares[frame + 1] = gamma * gamma * squares[frame] + ran[frame]


@inner
def statistic_of(
    total: float, prefix: Any, frame: int, place: int, history: int, gamma: float, evidence: bool
) -> float:
    """Statistic of a diagonal's sum: Σwz/√Σw² (evidence) or Σwz/Σw (mean).

    ``prefix`` are the squares for evidence and the weights for mean. The walk back stops at the
    start of the history, of the run or of the map, whichever is nearest.
    """
    span = min(history, frame, place)
    first = frame - span
    before = prefix[first]
    if gamma != 1.0:
        before *= (gamma * gamma if evidence else gamma) ** (span + 1)
    weight = prefix[frame + 1] - before
    return total / math.sqrt(weight) if evidence else total / weight  # type: ignore[no-any-return]


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
    out: Any,
) -> None:
    """Write the statistics of the candidates ``top`` (K,) at ``frame`` to ``out`` (K,)."""
    base = mark.origin - frame
    for rank in range(top.size):
        place = top[rank]
        out[rank] = statistic_of(
            sums[base + place], prefix, frame, place, history, gamma, evidence
        )


@inner
def tie(best: float) -> float:
    """How far below ``best`` a statistic still counts as equal."""
    return ABSOLUTE_TIE + RELATIVE_TIE * abs(best)


@compiled
def first_best(values: Any, size: int) -> int:
    """Index of the highest of ``values``; of equal ones the first."""
    best = values[0]
    for i in range(1, size):
        best = max(best, values[i])
    floor = best - tie(best)
    for i in range(size):
        if values[i] >= floor:
            return i
    return 0


@inner
def best_rival(values: Any, top: Any, size: int, place: int, tolerance: int, best: float) -> float:
    """Highest of ``best`` and the statistics of candidates beyond ``tolerance`` of ``place``."""
    for rank in range(size):
        if abs(top[rank] - place) > tolerance:
            best = max(best, values[rank])
    return best


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


class SIC:
    """Corrects one technique frame by frame (A-MuSIC, III-A).

    Args:
        references: R, places of the map.
        settings: statistic, K, F and γ.

    Example:
        >>> sic = SIC(references=3)
        >>> sic.correct([0.1, 0.9, 0.2]).place
        1

    Raises:
        ValueError: for a map without places.
    """

    def __init__(self, references: int, settings: SICSettings | None = None) -> None:
        if references < 1:
            raise ValueError(f"references is {references}; a map has at least one place")
        self.settings = settings or SICSettings()
        self.references = references
        self.frame = -1
        self._sums: NDArray[np.float64] = np.zeros(references + SLACK)
        self._mark = np.zeros(1, SUMS)
        self._mark["last"] = -1
        self._mark["origin"] = SLACK
        self._capacity = 0
        self._grow(64)

    def _grow(self, capacity: int) -> None:
        """Make room for the rows of ``capacity`` frames."""
        k = min(self.settings.candidates, self.references)
        shapes: dict[str, tuple[tuple[int, ...], Any]] = {
            "_rows": ((capacity, self.references), np.float32),
            "_mean": ((capacity,), np.float64),
            "_scale": ((capacity,), np.float64),
            "_top": ((capacity, k), np.int32),
            "_ready": ((capacity,), np.uint8),
            "_ran": ((capacity,), np.uint8),
            "_weights": ((capacity + 1,), np.float64),
            "_squares": ((capacity + 1,), np.float64),
        }
        for name, (shape, dtype) in shapes.items():
            new = np.zeros(shape, dtype)
            if self._capacity:
                old = getattr(self, name)
                new[: len(old)] = old
            setattr(self, name, new)
        self._capacity = capacity

    def _run(self) -> Any:
        """RUN record of the rows kept here."""
        run = np.zeros(1, RUN)
        for field in ("mean", "scale", "top", "ready"):
            run[field] = getattr(self, f"_{field}").ctypes.data
        run["scores"] = self._rows.ctypes.data
        run["references"] = self.references
        run["candidates"] = self._top.shape[1]
        return run[0]

    def skip(self) -> None:
        """Let a frame pass on which the technique does not run."""
        frame = self._advance()
        self._weigh(frame)

    def correct(self, row: ArrayLike) -> Match:
        """Take the technique's scores (R,) of the next frame and return the corrected match.

        Raises:
            ValueError: for scores of the wrong shape, or NaN or infinite ones.
        """
        scores = self._checked(row)
        frame = self._advance()
        self._rows[frame] = scores
        self._ran[frame] = 1
        return self._match(frame)

    def preview(self, row: ArrayLike) -> Match:
        """What :meth:`correct` would return for the next frame, without taking it."""
        saved = (self.frame, self._sums.copy(), self._mark.copy())
        match = self.correct(row)
        frame = self.frame
        self._ran[frame] = 0
        self._ready[frame] = 0
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
        if self.frame >= self._capacity:
            self._grow(2 * self._capacity)
        return self.frame

    def _weigh(self, frame: int) -> None:
        gamma = self.settings.gamma
        weigh(self._weights, self._squares, self._ran, frame, frame + 1, gamma)

    def _match(self, frame: int) -> Match:
        settings, run, mark = self.settings, self._run(), self._mark[0]
        evidence = settings.statistic == "evidence"
        prepare(run, frame)
        push(self._sums, mark, run, self._ran, frame, settings.history, settings.gamma)
        self._weigh(frame)
        top = self._top[frame]
        values = np.empty(top.size)
        prefix = self._squares if evidence else self._weights
        score_candidates(
            self._sums, mark, top, prefix, frame, settings.history, settings.gamma, evidence, values
        )
        winner = first_best(values, values.size)
        return Match(int(top[winner]), float(values[winner]), float(values[winner] - values[0]))
