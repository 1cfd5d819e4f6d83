"""What a batch of routes remembers and what a step gives: the records, and how kernels see them.

:class:`amusic_gym.envs.episode.Episodes` owns the arrays; compiled functions take the address of a
table (:mod:`amusic_gym.kernels.tables`) and read them by the same names.
"""

from __future__ import annotations

import math
import struct
import sys
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import RUN
from amusic_gym.estimation.observation import observation_size
from amusic_gym.estimation.sic import SUMS
from amusic_gym.kernels.tables import Layout, reader

PAST_END = -1
"""In ``bad_row``: the route had ended before the step."""

LIVE, LAGGED = 0, 1
"""Two sets of running sums: up to the last frame, and up to the block that may be re-selected."""

ROUTE = np.dtype(
    [
        ("frame", np.int64),  # last frame processed, -1 after a reset
        ("frames", np.int64),  # length of the episode's route
        ("bank", np.int64),  # number of the bank in the environment's list
        ("references", np.int64),
        ("tolerance", np.int64),
        ("total_seconds", np.float64),  # Σ seconds of the techniques present
        ("compute_weight", np.float64),  # λ
        ("weight_log", np.float64),  # λ as the observation has it
        ("prediction", np.int64),  # -1 until there is one
        ("confidence", np.float64),
        ("margin", np.float64),
        ("p_correct", np.float64),
        ("p_correct_mean", np.float64),
        ("continues", np.float64),  # 1 if the prediction moved on by one place
        ("track", np.float64),  # tens of frames in a row on which it did
        ("recent", np.float64),  # running mean of the similarity where something ran
        ("heard", np.float64),  # how much another technique than the chosen one has a say
        ("support", np.float64),  # ... and says the same
        ("logit", np.float64),  # of p_correct
        ("since_confirmed", np.float64),  # frames since a technique that ran confirmed it
        ("since_doubt", np.float64),
        ("spent", np.float64),  # seconds to charge for this step; -1: those declared of its runs
        ("compute", np.float64),  # seconds of this step / total_seconds
        ("compute_mean", np.float64),
        ("agreeing", np.float64),  # share of techniques whose diagonal is the fused one
        ("steady", np.float64),  # belief in steady motion
        ("said", np.float64),  # belief: log-likelihood that the frame's rows gave the prediction
        ("said_mean", np.float64),  # running mean of its mean over the rows
        ("strange", np.float64),  # how much more than usual the rows changed, as a ratio
        ("size_log", np.float64),  # length of the map as the observation has it
    ]
)

SLOT = np.dtype(
    [
        ("present", np.uint8),
        ("seconds", np.float64),  # declared cost of one run
        ("cost_share", np.float64),  # costs as the observation has them
        ("cost_log", np.float64),
        ("price", np.float64),
        ("ran", np.uint8),  # on this frame
        ("chosen", np.uint8),  # trusted by MuSIC on this frame
        ("last_run", np.int64),  # -1 before the first
        ("place", np.int64),  # corrected match of the last run
        ("statistic", np.float64),
        ("rival", np.float64),  # statistic of the technique's own best rival, -inf: none
        ("margin", np.float64),  # over that rival
        ("correction", np.float64),
        ("agrees", np.float64),  # 1 if place, moved along its diagonal, is the fused one
        ("agreement", np.float64),  # running mean of agrees over the runs
        ("support", np.float64),  # z-score of the fused place in the last row
        ("support_mean", np.float64),
        ("support_usual", np.float64),  # slow running mean
        ("confirms", np.float64),  # 1 if the last row's own best place is the fused one
        ("confirmation", np.float64),  # running mean of confirms over the runs
        ("runs", np.float64),  # number of runs
        ("stored", np.float64),  # what the last run said for the fused diagonal
        ("trust", np.float64),  # belief: probability that a row is informative
        ("sharpness", np.float64),  # belief: how sharp they are on average, of at most 1
        ("weight", np.float64),  # of its rows, less where they repeat the ones before
        ("likeness", np.float64),  # correlation of its row with the chosen one's on the same frame
        ("discount", np.float64),  # what MuSIC multiplies the statistic by
        ("lagged", np.int64),  # frames before this one are in the lagged sums
    ],
    align=True,
)

MIND = np.dtype(
    [
        ("side", np.int64),  # which of the two buffers holds the belief
        ("frame", np.int64),  # last frame that it includes, -1 before the first
        ("steady", np.float64),  # belief in steady motion
        ("strange", np.float64),  # change of the rows over what is usual
        ("place", np.int64),  # whose surroundings hold most of the belief
        ("share", np.float64),  # how much of it
        ("rival", np.float64),  # share of the best surroundings apart from these
        ("said", np.float64),  # log-likelihood that the frame's rows gave the place, their sum
        ("heard", np.int64),  # number of these rows
    ]
)
"""Bookkeeping of one route's belief."""

WITNESS = np.dtype(
    [
        ("count", np.float64),  # rows seen
        ("last", np.int64),  # frame of the last one, -1: none
        ("weight", np.float64),  # of the present row, ≤ 1
        ("novelty", np.float64),  # running mean of 1 − correlation with the row before
        ("contrast", np.float64),  # running mean of the rows' deviation
        ("trust", np.float64),  # probability that its rows are informative, the sum of these:
        ("once", np.float64),  # probability that they are, with sharpness 1,
        ("twice", np.float64),  # ... 2
        ("fourfold", np.float64),  # ... 4
        ("place", np.int64),  # most probable place by this technique's row alone
        ("statistic", np.float64),  # its log-odds
        ("correction", np.float64),  # ... less those of the uncorrected match
        ("margin", np.float64),  # log of its probability over that of the best rival
        ("said", np.float64),  # log-likelihood that the row gave the place believed in
    ]
)
"""What is known of one technique on one route."""


class Rules(NamedTuple):
    """Numbers that hold for every route of a batch."""

    history: int
    gamma: float
    evidence: bool
    belief: bool
    carry: bool
    block: int  # M; 0: no re-select bit
    coverage: float  # E
    allow_idle: bool
    calibration: NDArray[np.float64]  # (C,), see amusic_gym.estimation.calibration


class State(NamedTuple):
    """What a batch of routes remembers."""

    routes: NDArray[Any]  # (N,) ROUTE
    slots: NDArray[Any]  # (N, S) SLOT
    runs: NDArray[Any]  # (N, S) RUN
    marks: NDArray[Any]  # (2, N, S) SUMS
    sums: NDArray[np.float64]  # (2, N, S, R + SLACK); one set only without re-selection
    ran: NDArray[np.uint8]  # (N, S, Q)
    counts: NDArray[np.int32]  # (N, S, Q + 1), see sic.weigh
    prefix: NDArray[np.float64]  # (N, S, Q + 1); γ = 1: (N, S, 0)
    places: NDArray[np.int32]  # (N, S, Q) SIC's match where a technique ran; M = 0: (N, S, 0)
    predictions: NDArray[np.int32]  # (N, Q) the fused predictions; M = 0: (N, 0)
    values: NDArray[np.float64]  # (S, K + CARRIED) scratch: statistics of the candidates
    carried: NDArray[np.int64]  # (S, CARRIED) scratch: candidates carried on from earlier frames
    scratch: NDArray[np.float64]  # (S,) more scratch
    factors: NDArray[np.float64]  # (F + 2,), see sic.factors_of; no longer than the map needs
    minds: NDArray[Any]  # (N,) MIND: what the belief came to; not used without
    witnesses: NDArray[Any]  # (N, S) WITNESS: what each technique made of it
    late: NDArray[np.int64]  # (N, S) runs that looking back at the last block took
    statistics: NDArray[np.float64]  # (N, M, S) statistics on its frames
    corrections: NDArray[np.float64]  # (N, S, M)


RESULT = np.dtype(
    [
        ("frame", np.int64),
        ("prediction", np.int64),
        ("confidence", np.float64),
        ("similarity", np.float64),  # z-score of the place in the trusted technique's row, 0: none
        ("p_correct", np.float64),
        ("margin", np.float64),  # 0 without a rival
        ("technique", np.int64),  # trusted by MuSIC, -1: none
        ("seconds", np.float64),  # cost of this step, after-the-fact runs included
        ("fallback", np.bool_),  # the action was empty and the cheapest technique ran
        ("idle", np.bool_),  # nothing ran
        ("route", np.int64),  # number of the bank
        ("compute_weight", np.float64),  # λ
        ("compute", np.float64),  # seconds / Σ seconds
        ("ended", np.bool_),  # the route's last frame has been processed
        ("happened", np.bool_),  # a selection was done in this step
        ("bad_row", np.int64),  # 0, 1 + slot · frames + frame of a row not finite, or PAST_END
    ],
    align=True,
)

SLOT_RESULT = np.dtype(
    [
        ("ran", np.bool_),
        ("place", np.int64),  # corrected match
        ("statistic", np.float64),
        ("correction", np.float64),
        ("present", np.bool_),
        ("run_seconds", np.float64),  # declared cost of one run
        ("selected", np.bool_),  # in the set that a selection of this step chose
        ("tally", np.int64),  # frames of the block on which MuSIC chose the technique
        ("late_runs", np.int64),  # after-the-fact runs of this step
    ],
    align=True,
)


LINE = 64
"""Arrays of an outcome lie apart by multiples of this: a cache line, in bytes."""

_KINDS = [RESULT[name].kind for name in RESULT.names or ()]
_NUMBERS = struct.Struct("".join({"i": "q", "f": "d", "b": "?"}[kind] for kind in _KINDS))
"""Reads a ``RESULT`` as Python's numbers."""


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
        self.routes = self._place((routes,), RESULT)
        self.slots = self._place((routes, slots), SLOT_RESULT)
        self.corrections = self._place((routes, slots, block), np.float64)
        self.observation = self._place((routes, observation_size(slots)), np.float32)
        self._kept = [np.empty(0, np.uint8)]  # the first only shows what unused means

    def _place(self, shape: tuple[int, ...], kind: Any) -> tuple[tuple[int, ...], Any, int]:
        dtype, start = np.dtype(kind), self.size
        self.size += math.ceil(math.prod(shape) * dtype.itemsize / LINE) * LINE
        return shape, dtype, start

    def memory(self) -> NDArray[np.uint8]:
        """Memory of that size which nobody looks at: an earlier outcome's, or new.

        A system gives a large piece page by page, which takes longer than to write to it.
        """
        unused = -1  # references to an array that nothing but the list refers to, views included
        for array in self._kept:
            references = sys.getrefcount(array)
            if references <= unused:
                return array
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
        for array in twin.arrays():
            array[~mask] = np.zeros((), array.dtype)
        return twin

    def take(self, other: Outcome, mask: NDArray[np.bool_]) -> None:
        """Take over what another one holds of the routes of a mask (N,)."""
        for ours, theirs in zip(self.arrays(), other.arrays(), strict=True):
            ours[mask] = theirs[mask]

    def arrays(self) -> tuple[NDArray[Any], ...]:
        """All four."""
        return self.routes, self.slots, self.corrections, self.observation

    def _array(self, shape: tuple[int, ...], dtype: Any, start: int) -> NDArray[Any]:
        return np.ndarray(shape, dtype, self.memory, start)

    @property
    def routes(self) -> NDArray[Any]:
        """(N,) RESULT."""
        return self._array(*self.shape.routes)

    @property
    def slots(self) -> NDArray[Any]:
        """(N, S) SLOT_RESULT."""
        return self._array(*self.shape.slots)

    @property
    def corrections(self) -> NDArray[np.float64]:
        """(N, S, M) corrections over the block of a selection."""
        return self._array(*self.shape.corrections)

    @property
    def observation(self) -> NDArray[np.float32]:
        """(N, D) float32."""
        return self._array(*self.shape.observation)

    def first(self) -> tuple[Any, ...]:
        """The first route's ``RESULT`` as Python's numbers, sooner than from :attr:`routes`."""
        return _NUMBERS.unpack_from(self.memory.data)


class Batch(NamedTuple):
    """Everything that a step of N routes reads and writes."""

    state: State
    rules: Rules
    active: NDArray[np.bool_]  # (N,) routes to step
    actions: NDArray[np.bool_]  # (N, A); A = S, or S + 1 with the re-select bit last
    out: Outcome


BATCH = Layout(
    "Batch",
    {
        "state": Layout(
            "State",
            {
                "routes": (ROUTE, 1),
                "slots": (SLOT, 2),
                "runs": (RUN, 2),
                "marks": (SUMS, 3),
                "sums": (np.float64, 4),
                "ran": (np.uint8, 3),
                "counts": (np.int32, 3),
                "prefix": (np.float64, 3),
                "places": (np.int32, 3),
                "predictions": (np.int32, 2),
                "values": (np.float64, 2),
                "carried": (np.int64, 2),
                "scratch": (np.float64, 1),
                "factors": (np.float64, 1),
                "minds": (MIND, 1),
                "witnesses": (WITNESS, 2),
                "late": (np.int64, 2),
                "statistics": (np.float64, 3),
                "corrections": (np.float64, 3),
            },
        ),
        "rules": Layout(
            "Rules",
            {
                "history": int,
                "gamma": float,
                "evidence": bool,
                "belief": bool,
                "carry": bool,
                "block": int,
                "coverage": float,
                "allow_idle": bool,
                "calibration": (np.float64, 1),
            },
        ),
        "active": (np.bool_, 1),
        "actions": (np.bool_, 2),
        "out": Layout(
            "Outcome",
            {
                "routes": (RESULT, 1),
                "slots": (SLOT_RESULT, 2),
                "corrections": (np.float64, 3),
                "observation": (np.float32, 2),
            },
        ),
    },
)
"""How kernels see a :class:`Batch`."""

batch_at: Any = reader(BATCH)
