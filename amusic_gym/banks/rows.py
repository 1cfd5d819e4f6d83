"""What SIC needs to know of every score row, computed once per row, when first used."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.kernels.compiling import apart, compiled, inner
from amusic_gym.kernels.tables import Record, view

if TYPE_CHECKING:
    from amusic_gym.banks.bank import ScoreBank


MASKED = 2
"""What ``ready`` is for a row with places that are no candidates: their score is −∞."""

PREPARED = ("mean", "scale", "top", "ready", "serial")
"""What is kept of every row; fields of :class:`Run`."""


class PreparedRows:
    """Mean, scale and candidates of the rows of a bank (A-MuSIC, III-A and III-B).

    The kernels fill a row's entries the first time a technique runs on it, so that a large
    memory-mapped bank is never read as a whole.

    Attributes:
        candidates: K, already clipped to the map's length.
        mean: (T, Q) float64, mean of each score row; over its candidates, as ``scale`` is.
        scale: (T, Q) float64, 1/σ of each row, 0 for a constant one.
        top: (T, Q, K) int32, the K best places, ranked; ties to the lower index.
        ready: (T, Q) uint8, 1 where the row's entries are filled, or `MASKED`.
        serial: (T, Q) float64, see :func:`serial_correlation`; NaN where it is not known yet.
    """

    def __init__(self, bank: ScoreBank, candidates: int) -> None:
        techniques, queries, references = bank.shape
        self.candidates = min(candidates, references)
        self.mean: NDArray[np.float64] = np.zeros((techniques, queries))
        self.scale: NDArray[np.float64] = np.zeros((techniques, queries))
        self.top: NDArray[np.int32] = np.zeros((techniques, queries, self.candidates), np.int32)
        self.ready: NDArray[np.uint8] = np.zeros((techniques, queries), np.uint8)
        self.serial: NDArray[np.float64] = np.full((techniques, queries), np.nan)
        self.references = references
        self._addresses: dict[str, NDArray[np.int64]] = {}  # (T,) of every technique's entries
        for name in PREPARED:
            self._addresses[name] = _addresses(getattr(self, name))
        self._addresses["scores"] = _addresses(bank.stored)[bank.index]

    def point(self, runs: NDArray[Any], columns: NDArray[np.int64]) -> None:
        """Write to the Run records (S,) where the rows of techniques lie in memory.

        All but ``start`` and ``entries``; ``columns`` (S,) are their techniques.
        """
        runs["references"] = self.references
        runs["candidates"] = self.candidates
        for name, addresses in self._addresses.items():
            runs[name] = addresses[columns]


def _addresses(array: NDArray[Any]) -> NDArray[np.int64]:
    """Address of each entry along the first axis."""
    return array.ctypes.data + array.strides[0] * np.arange(len(array))


class Run(Record):
    """Where one technique's rows lie in memory: addresses of PreparedRows' entries of it."""

    scores: int  # address of the technique's (Q, R) float32 scores
    mean: int
    scale: int
    top: int
    ready: int
    serial: int
    start: int  # the query that is frame 0
    entries: int  # live: address of each frame's row number (Q,) int64; 0: in order
    references: int  # R
    candidates: int  # K, clipped to R


@dataclass
class RowBuffer:
    """Rows of one technique that come one by one; room for C of them."""

    rows: NDArray[np.float32]  # (C, R)
    mean: NDArray[np.float64]  # (C,)
    scale: NDArray[np.float64]  # (C,)
    top: NDArray[np.int32]  # (C, K)
    ready: NDArray[np.uint8]  # (C,)
    serial: NDArray[np.float64]  # (C,)

    @classmethod
    def empty(cls, capacity: int, references: int, candidates: int) -> RowBuffer:
        """Room for ``capacity`` rows; K is clipped to R."""
        return cls(
            rows=np.zeros((capacity, references), np.float32),
            mean=np.zeros(capacity),
            scale=np.zeros(capacity),
            top=np.zeros((capacity, min(candidates, references)), np.int32),
            ready=np.zeros(capacity, np.uint8),
            serial=np.full(capacity, np.nan),
        )

    def grown(self, capacity: int) -> RowBuffer:
        """The same with more room."""
        twin = self.empty(capacity, self.rows.shape[1], self.top.shape[1])
        for field in fields(self):
            old = getattr(self, field.name)
            getattr(twin, field.name)[: len(old)] = old
        return twin

    def put(self, entry: int, row: NDArray[np.float32]) -> None:
        """Store a row; what SIC needs of it is computed when it is first used."""
        self.rows[entry] = row
        self.ready[entry], self.serial[entry] = 0, np.nan

    def point(self, run: Any) -> None:
        """Write the addresses to a Run record."""
        run["scores"] = self.rows.ctypes.data
        for name in PREPARED:
            run[name] = getattr(self, name).ctypes.data
        run["references"] = self.rows.shape[1]
        run["candidates"] = self.top.shape[1]


@inner
def entry_of(run: Run, frame: int) -> int:
    """Number of a frame's row: a bank's are in order, a live route's where they were put."""
    if run.entries == 0:
        entry: int = run.start + frame
    else:
        entry = view(run.entries + frame * 8, 1, np.int64)[0]
    return entry


@inner
def row_at(run: Run, frame: int) -> Any:
    """Score row (R,) of a frame."""
    size = run.references
    return view(run.scores + entry_of(run, frame) * size * 4, size, np.float32)


@inner
def mean_at(run: Run, frame: int) -> Any:
    """Mean of a frame's row."""
    return view(run.mean + entry_of(run, frame) * 8, 1, np.float64)


@inner
def scale_at(run: Run, frame: int) -> Any:
    """1/σ of a frame's row."""
    return view(run.scale + entry_of(run, frame) * 8, 1, np.float64)


@inner
def top_at(run: Run, frame: int) -> Any:
    """Candidates (K,) of a frame, ranked."""
    size = run.candidates
    return view(run.top + entry_of(run, frame) * size * 4, size, np.int32)


@inner
def ready_at(run: Run, frame: int) -> Any:
    """Whether the entries of a frame's row are filled."""
    return view(run.ready + entry_of(run, frame), 1, np.uint8)


@inner
def serial_at(run: Run, frame: int) -> Any:
    """Correlation of a frame's row with the row before it, NaN where it is not known yet."""
    return view(run.serial + entry_of(run, frame) * 8, 1, np.float64)


@inner
def deviation(score: float, mean: float) -> float:
    """A score less its row's mean; 0 for a place that is no candidate: it says nothing there."""
    return score - mean if score != -math.inf else 0.0


@inner
def is_masked(run: Run, frame: int, place: int) -> bool:
    """Whether a place is no candidate in a prepared row; a row without any is as a constant one."""
    masked = False
    if ready_at(run, frame)[0] == MASKED:
        row = row_at(run, frame)
        masked = row[place] == -math.inf and row[top_at(run, frame)[0]] != -math.inf
    return masked


@inner
def worse(scores: NDArray[np.float32], a: int, b: int) -> bool:
    """Whether place ``a`` ranks behind place ``b``: lower score, or equal and of higher index."""
    return scores[a] < scores[b] or (scores[a] == scores[b] and a > b)


@apart
def sift(scores: NDArray[np.float32], heap: NDArray[np.int64], root: int, size: int) -> None:
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
def rank_candidates(scores: NDArray[np.float32], top: NDArray[np.int64]) -> None:
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
def prepare(run: Run, frame: int) -> bool:
    """Fill mean, scale and candidates of a frame's row once; False if a score is NaN or +∞."""
    ready = ready_at(run, frame)
    if ready[0]:
        return True
    row = row_at(run, frame)
    total, size = 0.0, 0
    lowest, highest = math.inf, -math.inf
    for place in range(row.size):
        if row[place] != -math.inf:
            total += row[place]
            size += 1
            lowest = min(lowest, row[place])
            highest = max(highest, row[place])
    if not math.isfinite(total):
        return False
    mean = total / max(size, 1)
    square = 0.0
    for place in range(row.size):
        square += deviation(row[place], mean) ** 2
    mean_at(run, frame)[0] = mean
    # Asked of the extremes, because rounding can leave a constant row a σ that is not quite 0.
    scale_at(run, frame)[0] = 0.0 if highest <= lowest else 1.0 / math.sqrt(square / size)
    rank_candidates(row, top_at(run, frame))
    ready[0] = 1 if size == row.size else MASKED
    return True


@apart
def masked_correlation(one: Run, past: int, other: Run, frame: int, shift: int) -> float:
    """As :func:`correlation`, over the c that are candidates in both rows."""
    before, now = row_at(one, past), row_at(other, frame)
    mean_before, mean_now = mean_at(one, past)[0], mean_at(other, frame)[0]
    total, pairs = 0.0, 0
    for i in range(now.size - shift):
        if before[i] != -math.inf and now[i + shift] != -math.inf:
            total += (before[i] - mean_before) * (now[i + shift] - mean_now)
            pairs += 1
    scale: float = scale_at(one, past)[0] * scale_at(other, frame)[0]
    return total * scale / max(pairs, 1)


@apart
def correlation(one: Run, past: int, other: Run, frame: int, shift: int) -> float:
    """Mean product of the z-scores of a row's place c − shift and another row's place c.

    Over all c that both have, 0 where there is none. Both rows must be there and prepared.
    """
    if ready_at(one, past)[0] == MASKED or ready_at(other, frame)[0] == MASKED:
        return masked_correlation(one, past, other, frame, shift)
    before, now = row_at(one, past), row_at(other, frame)
    mean_before, mean_now = mean_at(one, past)[0], mean_at(other, frame)[0]
    a, b, c, d = 0.0, 0.0, 0.0, 0.0  # four lanes: additions of one chain wait for each other
    pairs = now.size - shift
    even = pairs - pairs % 4
    for i in range(0, even, 4):
        a += (before[i] - mean_before) * (now[i + shift] - mean_now)
        b += (before[i + 1] - mean_before) * (now[i + 1 + shift] - mean_now)
        c += (before[i + 2] - mean_before) * (now[i + 2 + shift] - mean_now)
        d += (before[i + 3] - mean_before) * (now[i + 3 + shift] - mean_now)
    for i in range(even, pairs):
        a += (before[i] - mean_before) * (now[i + shift] - mean_now)
    scale: float = scale_at(one, past)[0] * scale_at(other, frame)[0]
    mean: float = ((a + b) + (c + d)) * scale / max(pairs, 1)
    return mean


@inner
def serial_correlation(run: Run, frame: int) -> float:
    """Correlation of a frame's row with the technique's row one frame before, moved on by a place.

    It is computed once per row.
    """
    known = serial_at(run, frame)
    if math.isnan(known[0]):
        prepare(run, frame - 1)  # again in an unpickled environment, whose bank starts unprepared
        known[0] = correlation(run, frame - 1, run, frame, 1)
    value: float = known[0]
    return value
