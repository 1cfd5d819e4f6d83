"""What one step gives: the records of its outcome, and the names of what infos hold of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym.kernels.tables import Record, Table, array

Infos = dict[str, Any]


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


PAST_END = -1
"""In ``bad_row``: the route had ended before the step."""

RESULTS = RouteResult.dtype.names or ()
ROUTE_INFOS = RESULTS[: 1 + RESULTS.index("compute_weight")]
TECHNIQUE_INFOS = ("ran", "place", "statistic", "correction", "present", "run_seconds")
SELECTION_INFOS = ("tally", "selected", "late_runs")


class OutcomeTable(Table):
    """The arrays of an :class:`Outcome` as kernels see them."""

    routes: NDArray[Any] = array(RouteResult, "routes")
    slots: NDArray[Any] = array(SlotResult, "routes", "slots")
    corrections: NDArray[np.float64] = array(np.float64, "routes", "slots", "block")
    observation: NDArray[np.float32] = array(np.float32, "routes", "entries")

    @classmethod
    def one_record(cls, sizes: Mapping[str, int]) -> np.dtype[np.void]:
        """The arrays as fields of one record: to copy its memory is to copy them all.

        Args:
            sizes: ``routes`` N, ``slots`` S, ``block`` M and ``entries`` D.
        """
        fields = [
            (name, column.dtype, tuple(sizes[size] for size in column.sizes))
            for name, column in cls.columns.items()
        ]
        return np.dtype(fields, align=True)


class Outcome(NamedTuple):
    """What one step gives of N routes with S slots; nobody else writes to its arrays."""

    routes: NDArray[Any]  # (N,) RouteResult
    slots: NDArray[Any]  # (N, S) SlotResult
    corrections: NDArray[np.float64]  # (N, S, M) over the block of a selection; M = 0 without
    observation: NDArray[np.float32]  # (N, D)

    def copy(self) -> Outcome:
        """One with arrays of its own."""
        return Outcome(
            self.routes.copy(), self.slots.copy(), self.corrections.copy(), self.observation.copy()
        )

    def only(self, mask: NDArray[np.bool_]) -> Outcome:
        """A copy that is zero outside a mask (N,) of routes."""
        twin = self.copy()
        arrays: tuple[NDArray[Any], ...] = twin
        for values in arrays:
            values[~mask] = np.zeros((), values.dtype)
        return twin

    def take(self, other: Outcome, mask: NDArray[np.bool_]) -> None:
        """Take over what another one holds of the routes of a mask (N,)."""
        pairs: Iterable[tuple[NDArray[Any], NDArray[Any]]] = zip(self, other, strict=True)
        for ours, theirs in pairs:
            ours[mask] = theirs[mask]
