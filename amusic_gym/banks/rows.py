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


UNREAD, READY, MASKED = 0, 1, 2
"""What is known of a row: nothing yet; all; all, and some places are no candidates (score −∞)."""


class PreparedRow(Record):
    """What SIC needs to know of a score row besides its best places."""

    mean: float  # over the candidates, as is the deviation
    scale: float  # 1/σ, 0 for a constant row
    serial: float  # correlation with the row before, moved on by a place; NaN: not known yet
    state: int  # UNREAD, READY or MASKED


class Run(Record):
    """Where one technique's rows lie in memory."""

    scores: int  # address of the (Q, R) float32 scores
    prepared: int  # address of the (Q,) `PreparedRow` records
    top: int  # address of the (Q, K) int32 best places
    start: int  # the query that is frame 0
    entries: int  # live: address of each frame's row number (Q,) int64; 0: in order
    references: int  # R
    candidates: int  # K, clipped to R


class PreparedRows:
    """What SIC needs to know of the rows of a bank (A-MuSIC, III-A and III-B).

    The kernels fill a row's entries the first time a technique runs on it, so that a large
    memory-mapped bank is never read as a whole.
    """

    def __init__(self, bank: ScoreBank, candidates: int) -> None:
        techniques, queries, self.references = bank.shape
        self.candidates = min(candidates, self.references)  # K
        self.prepared: NDArray[Any] = np.zeros((techniques, queries), PreparedRow.dtype)
        self.prepared["serial"] = np.nan
        # (T, Q, K) the best places, ranked; ties to the lower index
        self.top: NDArray[np.int32] = np.zeros((techniques, queries, self.candidates), np.int32)
        self._addresses = {  # (T,) of every technique's rows
            "scores": _addresses(bank.stored)[bank.index],
            "prepared": _addresses(self.prepared),
            "top": _addresses(self.top),
        }

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


@dataclass
class RowBuffer:
    """Rows of one technique that come one by one; room for C of them."""

    rows: NDArray[np.float32]  # (C, R)
    prepared: NDArray[Any]  # (C,) PreparedRow
    top: NDArray[np.int32]  # (C, K)

    @classmethod
    def empty(cls, capacity: int, references: int, candidates: int) -> RowBuffer:
        """Room for ``capacity`` rows; K is clipped to R."""
        return cls(
            rows=np.zeros((capacity, references), np.float32),
            prepared=np.zeros(capacity, PreparedRow.dtype),
            top=np.zeros((capacity, min(candidates, references)), np.int32),
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
        self.prepared[entry] = (0.0, 0.0, np.nan, UNREAD)

    def point(self, run: Any) -> None:
        """Write the addresses to a Run record."""
        run["scores"] = self.rows.ctypes.data
        run["prepared"] = self.prepared.ctypes.data
        run["top"] = self.top.ctypes.data
        run["references"] = self.rows.shape[1]
        run["candidates"] = self.top.shape[1]


_PREPARED = PreparedRow.dtype
_SIZE = _PREPARED.itemsize


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
    """Score row (R,) float32 of a frame."""
    size = run.references
    return view(run.scores + entry_of(run, frame) * size * 4, size, np.float32)


@inner
def prepared_at(run: Run, frame: int) -> Any:
    """:class:`PreparedRow` of a frame."""
    return view(run.prepared + entry_of(run, frame) * _SIZE, 1, _PREPARED)[0]


@inner
def top_at(run: Run, frame: int) -> Any:
    """Candidates (K,) int32 of a frame, ranked."""
    size = run.candidates
    return view(run.top + entry_of(run, frame) * size * 4, size, np.int32)


@inner
def deviation(score: float, mean: float) -> float:
    """A score less its row's mean; 0 for a place that is no candidate: it says nothing there."""
    return score - mean if score != -math.inf else 0.0


@inner
def z_at(run: Run, frame: int, place: int) -> float:
    """Z-score of a place in a prepared row."""
    prepared = prepared_at(run, frame)
    z: float = deviation(row_at(run, frame)[place], prepared.mean) * prepared.scale
    return z


@apart
def rank_candidates(scores: NDArray[np.float32], top: NDArray[np.int32]) -> None:
    """Fill ``top`` (K,) with the best places of ``scores`` (R,), ranked, ties to the lower."""
    for place in range(scores.size):
        rank = min(place, top.size)
        while rank > 0 and scores[place] > scores[top[rank - 1]]:
            if rank < top.size:
                top[rank] = top[rank - 1]
            rank -= 1
        if rank < top.size:
            top[rank] = place


@compiled
def prepare(run: Run, frame: int) -> bool:
    """Fill mean, scale and candidates of a frame's row once; False if a score is NaN or +∞."""
    prepared = prepared_at(run, frame)
    if prepared.state != UNREAD:
        return True
    row = row_at(run, frame)
    total, size = 0.0, 0
    lowest, highest = math.inf, -math.inf
    for place in range(row.size):
        score = float(row[place])
        if score != -math.inf:
            total += score
            size += 1
            lowest = min(lowest, score)
            highest = max(highest, score)
    if not math.isfinite(total):
        return False
    mean = total / max(size, 1)
    square = 0.0
    for place in range(row.size):
        square += deviation(row[place], mean) ** 2
    prepared.mean = mean
    # Asked of the extremes, because rounding can leave a constant row a σ that is not quite 0.
    prepared.scale = 0.0 if highest <= lowest else 1.0 / math.sqrt(square / size)
    rank_candidates(row, top_at(run, frame))
    prepared.state = READY if size == row.size else MASKED
    return True


@apart
def correlation(one: Run, past: int, other: Run, frame: int, shift: int) -> float:
    """Mean product of the z-scores of a row's place c − shift and another row's place c.

    Over all c that are candidates in both, 0 where there is none. Both rows must be prepared.
    """
    before, now = row_at(one, past), row_at(other, frame)
    first, second = prepared_at(one, past), prepared_at(other, frame)
    mean_before, mean_now = first.mean, second.mean
    a, b, c, d = 0.0, 0.0, 0.0, 0.0  # four lanes: additions of one chain wait for each other
    pairs = now.size - shift
    if first.state == MASKED or second.state == MASKED:
        pairs = 0
        for i in range(now.size - shift):
            if before[i] != -math.inf and now[i + shift] != -math.inf:
                a += (before[i] - mean_before) * (now[i + shift] - mean_now)
                pairs += 1
    else:
        even = pairs - pairs % 4
        for i in range(0, even, 4):
            a += (before[i] - mean_before) * (now[i + shift] - mean_now)
            b += (before[i + 1] - mean_before) * (now[i + 1 + shift] - mean_now)
            c += (before[i + 2] - mean_before) * (now[i + 2 + shift] - mean_now)
            d += (before[i + 3] - mean_before) * (now[i + 3 + shift] - mean_now)
        for i in range(even, pairs):
            a += (before[i] - mean_before) * (now[i + shift] - mean_now)
    scale: float = first.scale * second.scale
    mean: float = ((a + b) + (c + d)) * scale / max(pairs, 1)
    return mean
