"""What is remembered of a batch of routes: the state that environments and estimators share.

:class:`Batch` has N routes with S technique slots each. What an estimator remembers besides stands
in a table of its own (:mod:`amusic_gym.estimation.sic.state`, for example).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import Run
from amusic_gym.kernels.tables import Record, Table, array


class RouteState(Record):
    """One route of the batch."""

    # Of the episode.
    frame: int  # last frame processed, -1 after a reset
    frames: int  # length of the episode's route
    bank: int  # number of the bank in the environment's list
    references: int
    tolerance: int
    total_seconds: float  # Σ seconds of the techniques present
    compute_weight: float  # λ
    weight_log: float  # λ as the observation has it
    size_log: float  # length of the map as the observation has it
    # Of the step.
    idle: bool  # nothing ran
    fallback: bool  # the action was empty and the cheapest technique ran
    selected: bool  # a selection was done
    spent: float  # seconds to charge for the step; -1: those declared of its runs
    seconds: float  # cost of the step, after-the-fact runs included
    compute: float  # seconds / total_seconds
    compute_mean: float
    bad_row: int  # 0, 1 + slot · frames + frame of a row not finite, or PAST_END
    # The estimate.
    prediction: int  # -1 until there is one
    technique: int  # trusted by MuSIC, -1: none
    confidence: float
    margin: float  # of the confidence over the best rival's, 0 without a rival
    similarity: float  # z-score of the prediction in the trusted technique's row, 0: none
    p_correct: float
    p_correct_mean: float
    logit: float  # of p_correct
    continues: float  # 1 if the prediction moved on by one place
    track: float  # tens of frames in a row on which it did
    agreeing: float  # share of techniques whose diagonal is the fused one
    since_confirmed: float  # frames since a technique that ran confirmed the prediction
    since_doubt: float
    on_map: float  # log-odds of the robot being on the map
    # SIC.
    heard: float  # how much another technique than the chosen one has a say
    support: float  # ... and says the same
    # Belief.
    p_steady: float  # probability of steady motion
    log_likelihood: float  # of the prediction, by the frame's rows together
    log_likelihood_mean: float  # running mean of its mean over the rows


class SlotState(Record):
    """One technique slot of a route."""

    # Of the episode.
    present: bool
    seconds: float  # declared cost of one run
    cost_share: float  # costs as the observation has them
    cost_log: float
    price: float
    # Of the step.
    ran: bool  # on this frame
    chosen: bool  # trusted by MuSIC on this frame
    selected: bool  # in the set that a selection of this step chose
    tally: int  # frames of the block on which MuSIC chose the technique
    late_runs: int  # after-the-fact runs of this step
    # Of the technique's last run.
    last_run: int  # frame, -1 before the first
    runs: float  # number of runs
    place: int  # match
    statistic: float
    correction: float
    margin: float  # over its best rival
    discount: float  # what MuSIC multiplies the statistic by
    weight: float  # of its rows, less where they repeat the ones before
    stored: float  # what the last run said for the fused diagonal
    # Against the prediction.
    agrees: float  # 1 if place, moved along its diagonal, is the fused one
    agreement: float  # running mean of agrees over the runs
    support: float  # z-score of the fused place in the last row
    support_mean: float
    support_usual: float  # slow running mean
    confirms: float  # 1 if the last row's own best place is the fused one
    confirmation: float  # running mean of confirms over the runs
    confirmation_usual: float  # slow running mean
    # SIC.
    rival: float  # statistic of the technique's own best rival, -inf: none
    likeness: float  # correlation of its row with the chosen one's on the same frame
    lagged: int  # frames before this one are in the lagged sums


class Batch(Table):
    """N routes with S slots, room for Q frames, and M frames of a selection.

    Arrays: ``routes`` (N,), ``slots`` (N, S), ``runs`` (N, S) where the score rows lie, ``ran``
    (N, S, Q); ``active`` (N,) routes of this step, ``wanted`` (N,) those of them that select
    techniques anew, ``lagging`` (N,) those whose rows will not be there for long; ``statistics``
    (N, M, S) and ``corrections`` (N, S, M) on the frames of the last block, written by an
    estimator that looks back; ``scratch`` (S,).
    """

    block: int  # M; 0: no re-select bit
    routes: NDArray[Any] = array(RouteState, "routes")
    slots: NDArray[Any] = array(SlotState, "routes", "slots")
    runs: NDArray[Any] = array(Run, "routes", "slots")
    ran: NDArray[np.bool_] = array(np.bool_, "routes", "slots", "frames")
    active: NDArray[np.bool_] = array(np.bool_, "routes")
    wanted: NDArray[np.bool_] = array(np.bool_, "routes")
    lagging: NDArray[np.bool_] = array(np.bool_, "routes")
    statistics: NDArray[np.float64] = array(np.float64, "routes", "block", "slots")
    corrections: NDArray[np.float64] = array(np.float64, "routes", "slots", "block")
    scratch: NDArray[np.float64] = array(np.float64, "slots", kept=False)
