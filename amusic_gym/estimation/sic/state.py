"""What SIC remembers of a batch of routes."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.kernels.tables import Record, Table, array, reader

LIVE, LAGGED = 0, 1
"""Two sets of running sums: up to the last frame, and up to the block that may be re-selected."""

CARRIED = 2
"""Candidates besides the top K: the technique's own last match and the last fused prediction."""

SLACK = 512
"""Frames that the running sums move before their window is copied back."""

LARGE = 65_536
"""Places from which the sums of a map are too much for a fast cache: rows are added together."""

DEPTH = 8
"""How many then."""

SERIAL_PRIOR, SERIAL_PRIOR_ROWS = 0.5, 10.0
"""Serial correlation before the first row, and the number of rows that it is worth."""


class SumsState(Record):
    """Bookkeeping of one technique's running sums; float64 (R + SLACK,) sums go with it."""

    origin: int  # place c at frame n has its sum at sums[origin - n + c]
    last: int  # frame of the last row added, -1 before the first
    expired: int  # frames before this one have left the history
    since: int  # the technique ran on every frame from this one to last
    depth: int  # rows that wait to be added together, at most; 0: none ever waits
    waiting: int  # how many do now
    frames: Annotated[Any, np.int64, DEPTH]  # theirs, in order
    leaving: int  # rows that wait to be taken out
    left: Annotated[Any, np.int64, DEPTH]  # their frames
    discount: bool  # the serial correlation is kept
    serial: float  # running sum of the serial correlation
    serial_rows: float  # rows that it sums over, the prior's among them


class SICState(Table):
    """Memory of SIC and MuSIC for a batch of routes.

    Arrays: ``marks`` (sets, N, S) and ``sums`` (sets, N, S, R + SLACK), two sets with re-selection;
    ``counts`` (N, S, Q + 1) and, where γ < 1, ``prefix`` (N, S, Q + 1), see
    :func:`~amusic_gym.estimation.sic.sums.count_runs`; ``places`` (N, S, Q) matches of what ran
    and ``predictions`` (N, Q), both with re-selection only; scratch: ``candidates`` and ``values``
    (S, K + CARRIED), see :func:`~amusic_gym.estimation.sic.sums.correct_frame`; ``factors``
    (F + 2,), see :func:`factors_of`; ``calibration`` (C,), see
    :mod:`amusic_gym.estimation.calibration`.
    """

    batch: Batch
    history: int  # F
    gamma: float
    ratio: float  # of neighbouring rows' shares of the weight: γ² in Σw² (evidence), γ in Σw (mean)
    evidence: bool  # else the mean
    carry: bool
    calibration: NDArray[np.float64] = array(np.float64, "coefficients")
    factors: NDArray[np.float64] = array(np.float64, "factors", kept=False)
    marks: NDArray[Any] = array(SumsState, "sets", "routes", "slots")
    sums: NDArray[np.float64] = array(np.float64, "sets", "routes", "slots", "sums")
    counts: NDArray[np.int32] = array(np.int32, "routes", "slots", "counts")
    prefix: NDArray[np.float64] = array(np.float64, "routes", "slots", "prefix")
    places: NDArray[np.int32] = array(np.int32, "routes", "slots", "replayed")
    predictions: NDArray[np.int32] = array(np.int32, "routes", "replayed")
    candidates: NDArray[np.int32] = array(np.int32, "slots", "values", kept=False)
    values: NDArray[np.float64] = array(np.float64, "slots", "values", kept=False)


state_at: Any = reader(SICState)


def begin_sums(marks: Any, references: int, room: int, settings: SICSettings) -> None:
    """Reset :class:`SumsState` records of any shape.

    Args:
        marks: the records.
        references: R, places of the map.
        room: length of the running sums, R + SLACK or more.
        settings: of SIC.
    """
    marks[...] = np.zeros((), SumsState.dtype)
    marks["last"] = -1
    marks["origin"] = max(room - references, 0)
    marks["depth"] = depth_for(references, settings.gamma)
    marks["discount"] = settings.discount
    marks["serial"] = SERIAL_PRIOR * SERIAL_PRIOR_ROWS
    marks["serial_rows"] = SERIAL_PRIOR_ROWS


def depth_for(references: int, gamma: float) -> int:
    """How many rows wait to be added together, on a map of so many places.

    Eight rows in one pass move the sums through memory once instead of eight times; a look-up then
    also looks at the rows that wait.
    """
    return DEPTH if references >= LARGE and gamma == 1.0 else 0


def factors_of(most: int, evidence: bool) -> NDArray[np.float64]:
    """(most + 1,) factors that make statistics of the sums of so many rows, where γ = 1.

    To look them up is faster than a root and a division for every candidate.
    """
    counts = np.maximum(np.arange(most + 1.0), 1.0)
    factors: NDArray[np.float64] = 1.0 / (np.sqrt(counts) if evidence else counts)
    return factors
