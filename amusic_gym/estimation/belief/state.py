"""What the belief remembers of a batch of routes."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.belief.model import SHARES, SPEEDS, START_STEADY, STEADY
from amusic_gym.kernels.compiling import apart
from amusic_gym.kernels.tables import Record, Table, array, reader

LIVE, LAGGED = 0, 1
"""Two sets of the memory: up to the last frame, and up to the block that may be selected over."""


class RouteBelief(Record):
    """Summary of one route's belief after its last frame."""

    frame: int  # last frame that it includes, -1 before the first
    p_steady: float  # probability of steady motion
    place: int  # likeliest of those whose windows hold (almost) most
    share: float  # of the belief in its window
    rival: float  # share of the best window that has no place in common with it
    log_likelihood: float  # of the place, by the frame's rows together
    rows: int  # number of these rows


class TechniqueBelief(Record):
    """What one technique's last row made of the belief before it."""

    rows: float  # number of rows seen
    news: float  # how much of the last one was new, at most 1
    usual: float  # variance of the news of its rows, in that of a row
    change: float  # deviation of the last one's over the usual one
    weight: float  # of the last one among those of its frame
    place: int  # likeliest by it alone
    statistic: float  # log-odds of that place's window
    correction: float  # less those of the window of the row's best place
    margin: float  # logarithm of the ratio to the best rival window
    log_likelihood: float  # of the place that all techniques came to


class BeliefState(Table):
    """Memory of the belief for a batch of N routes with S slots; two sets with re-selection.

    Arrays: ``beliefs`` (sets, N), ``techniques`` (sets, N, S), ``modes`` (sets, N, MODES, R)
    probability of place and way of moving, ``hubs`` and ``variances`` (sets, N, S, R) mean row and
    variance of its places' scores, ``likenesses`` (sets, N, 2, S, S) correlations of techniques and
    the number of frames behind them; scratch: ``likelihoods`` and ``logs`` (S, R), ``weights``
    and ``sums`` (S,), ``prior``, ``joint``, ``windows`` (R,) and ``lines`` (2, REACH + 3 R +
    REACH_BACK). What has an entry per place is single, all else double.
    """

    batch: Batch
    calibration: NDArray[np.float64] = array(np.float64, "coefficients")
    beliefs: NDArray[Any] = array(RouteBelief, "sets", "routes")
    techniques: NDArray[Any] = array(TechniqueBelief, "sets", "routes", "slots")
    modes: NDArray[np.float32] = array(np.float32, "sets", "routes", "modes", "references")
    hubs: NDArray[np.float32] = array(np.float32, "sets", "routes", "slots", "references")
    variances: NDArray[np.float32] = array(np.float32, "sets", "routes", "slots", "references")
    likenesses: NDArray[np.float64] = array(np.float64, "sets", "routes", "two", "slots", "slots")
    likelihoods: NDArray[np.float32] = array(np.float32, "slots", "references", kept=False)
    logs: NDArray[np.float32] = array(np.float32, "slots", "references", kept=False)
    weights: NDArray[np.float64] = array(np.float64, "slots", kept=False)
    sums: NDArray[np.float64] = array(np.float64, "slots", kept=False)
    prior: NDArray[np.float32] = array(np.float32, "references", kept=False)
    joint: NDArray[np.float32] = array(np.float32, "references", kept=False)
    windows: NDArray[np.float32] = array(np.float32, "references", kept=False)
    lines: NDArray[np.float32] = array(np.float32, "two", "line", kept=False)

    def beside(self, active: NDArray[np.bool_]) -> BeliefState:
        """The same memory with scratch and active routes (N,) of its own, for another thread."""
        twin, twin_batch = copy.copy(self), copy.copy(self.batch)
        twin_batch.active = active
        twin.batch = twin_batch
        for name, column in self.columns.items():
            if not column.kept:
                setattr(twin, name, np.zeros_like(getattr(self, name)))
        return twin


state_at: Any = reader(BeliefState)


def begin(state: BeliefState, i: int, references: int) -> None:
    """Forget route ``i``: every place is as likely, nothing is known of the techniques."""
    state.beliefs[:, i] = np.zeros((), RouteBelief.dtype)
    state.beliefs[:, i]["frame"], state.beliefs[:, i]["p_steady"] = -1, START_STEADY
    state.techniques[:, i] = np.zeros((), TechniqueBelief.dtype)
    state.techniques[:, i]["place"] = -1
    state.modes[:, i] = 0.0
    state.modes[:, i, STEADY, :references] = START_STEADY / references
    for mode in range(SPEEDS):
        share = (1.0 - START_STEADY) * SHARES[mode]
        state.modes[:, i, mode, :references] = share / references
    state.hubs[:, i] = 0.0
    state.variances[:, i] = 1.0
    state.likenesses[:, i] = 0.0


@apart
def copy_rows(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Copy (n, R) numbers; a loop, because slices compile ten times as long."""
    for row in range(source.shape[0]):
        for place in range(source.shape[1]):
            target[row, place] = source[row, place]


@apart
def restart(state: BeliefState, i: int) -> None:
    """Make the live set of route ``i`` a copy of the lagged one."""
    state.beliefs[LIVE, i] = state.beliefs[LAGGED, i]
    for s in range(state.techniques.shape[2]):
        state.techniques[LIVE, i, s] = state.techniques[LAGGED, i, s]
    copy_rows(state.modes[LAGGED, i], state.modes[LIVE, i])
    copy_rows(state.hubs[LAGGED, i], state.hubs[LIVE, i])
    copy_rows(state.variances[LAGGED, i], state.variances[LIVE, i])
    for kind in range(2):
        copy_rows(state.likenesses[LAGGED, i, kind], state.likenesses[LIVE, i, kind])
