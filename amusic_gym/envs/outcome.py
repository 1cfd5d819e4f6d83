"""What one step gives: the records of its outcome, and how their arrays share memory."""

from __future__ import annotations

import math
import struct
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.observation import observation_size
from amusic_gym.kernels.tables import Record, Table, array


class RouteResult(Record):
    """What a step gives of one route; zeros, and no technique, where it took none."""

    frame: int
    prediction: int
    confidence: float
    similarity: float  # z-score of the place in the trusted technique's row, 0: none
    p_correct: float
    margin: float  # 0 without a rival
    technique: int  # trusted by MuSIC, -1: none
    seconds: float  # cost of this step, after-the-fact runs included
    fallback: bool  # the action was empty and the cheapest technique ran
    idle: bool  # nothing ran
    route: int  # number of the bank
    compute_weight: float  # λ
    compute: float  # seconds / Σ seconds
    ended: bool  # the route's last frame has been processed
    happened: bool  # a selection was done in this step
    bad_row: int  # 0, 1 + slot · frames + frame of a row not finite, or PAST_END


class SlotResult(Record):
    """What a step gives of one technique slot."""

    ran: bool
    place: int  # corrected match
    statistic: float
    correction: float
    present: bool
    run_seconds: float  # declared cost of one run
    selected: bool  # in the set that a selection of this step chose
    tally: int  # frames of the block on which MuSIC chose the technique
    late_runs: int  # after-the-fact runs of this step


class OutcomeTable(Table):
    """The arrays of an :class:`Outcome` as kernels see them."""

    routes: NDArray[Any] = array(RouteResult, "routes")
    slots: NDArray[Any] = array(SlotResult, "routes", "slots")
    corrections: NDArray[np.float64] = array(np.float64, "routes", "slots", "block")
    observation: NDArray[np.float32] = array(np.float32, "routes", "entries")


PAST_END = -1
"""In ``bad_row``: the route had ended before the step."""

LINE = 64
"""Arrays of an outcome lie apart by multiples of this: a cache line, in bytes."""

_KINDS = [RouteResult.dtype[name].kind for name in RouteResult.dtype.names or ()]
_NUMBERS = struct.Struct("".join({"i": "q", "f": "d", "b": "?"}[kind] for kind in _KINDS))
"""Reads a `RouteResult` as Python's numbers."""


KEPT = 4
"""Outcomes of a batch whose memory may be used again; while all are held, later ones get new."""


class OutcomeShape:
    """Where the arrays of an outcome lie in its memory, and memory to use again.

    Args:
        routes: N.
        slots: S.
        block: M, 0 without re-selection.
    """

    def __init__(self, routes: int, slots: int, block: int) -> None:
        self.block = block
        self.size = 0  # bytes
        sizes = {"routes": routes, "slots": slots, "block": block}
        sizes["entries"] = observation_size(slots)
        self.arrays = {
            name: self._place(tuple(sizes[size] for size in column.sizes), column.dtype)
            for name, column in OutcomeTable.columns.items()
        }
        self._kept = [np.empty(0, np.uint8)]  # the first only shows what unused means

    def _place(self, shape: tuple[int, ...], dtype: Any) -> tuple[tuple[int, ...], Any, int]:
        start = self.size
        self.size += math.ceil(math.prod(shape) * dtype.itemsize / LINE) * LINE
        return shape, dtype, start

    def memory(self) -> NDArray[np.uint8]:
        """Memory of that size which nobody looks at: an earlier outcome's, or new.

        A system gives a large piece page by page, which takes longer than to write to it.
        """
        unused = -1  # references to an array that nothing but the list refers to, views included
        for memory in self._kept:
            references = sys.getrefcount(memory)
            if references <= unused:
                return memory
            if unused < 0:
                unused = references
        new = np.empty(self.size, np.uint8)
        if len(self._kept) <= KEPT:
            self._kept.append(new)
        return new


class Outcome:
    """What one step gives. Its arrays share one piece of memory: copying that is copying all.

    Args:
        shape: where each of them lies.
        memory: (size,); zeros if None.
    """

    __slots__ = ("memory", "shape")

    def __init__(self, shape: OutcomeShape, memory: NDArray[np.uint8] | None = None) -> None:
        self.shape = shape
        self.memory = np.zeros(shape.size, np.uint8) if memory is None else memory

    def copy(self) -> Outcome:
        """One with memory of its own."""
        memory = self.shape.memory()
        memory[:] = self.memory
        return Outcome(self.shape, memory)

    def only(self, mask: NDArray[np.bool_]) -> Outcome:
        """A copy that is zero outside a mask (N,) of routes."""
        twin = self.copy()
        for values in twin.arrays():
            values[~mask] = np.zeros((), values.dtype)
        return twin

    def take(self, other: Outcome, mask: NDArray[np.bool_]) -> None:
        """Take over what another one holds of the routes of a mask (N,)."""
        for ours, theirs in zip(self.arrays(), other.arrays(), strict=True):
            ours[mask] = theirs[mask]

    def arrays(self) -> tuple[NDArray[Any], ...]:
        """All four."""
        return self.routes, self.slots, self.corrections, self.observation

    def _array(self, name: str) -> NDArray[Any]:
        shape, dtype, start = self.shape.arrays[name]
        return np.ndarray(shape, dtype, self.memory, start)

    @property
    def routes(self) -> NDArray[Any]:
        """(N,) `RouteResult` records."""
        return self._array("routes")

    @property
    def slots(self) -> NDArray[Any]:
        """(N, S) `SlotResult` records."""
        return self._array("slots")

    @property
    def corrections(self) -> NDArray[np.float64]:
        """(N, S, M) corrections over the block of a selection."""
        return self._array("corrections")

    @property
    def observation(self) -> NDArray[np.float32]:
        """(N, D) float32."""
        return self._array("observation")

    def first(self) -> tuple[Any, ...]:
        """The first route's `RouteResult` as Python's numbers, sooner than from :attr:`routes`."""
        return _NUMBERS.unpack_from(self.memory.data)
