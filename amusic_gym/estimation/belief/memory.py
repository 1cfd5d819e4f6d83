"""What the belief remembers of a batch of routes."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.belief.rates import WAYS, Rates, first_trust, share
from amusic_gym.kernels.compiling import apart
from amusic_gym.kernels.tables import Record, Table, array, reader

REACH = 3
"""Most places that one frame moves, slack included; the arrays begin with so many zeros."""

VOICE = np.dtype(
    [
        ("none", np.float64),  # likelihood of a place whose row value is x:
        ("once", np.float64),  # none + once x + twice x² + fourfold x⁴
        ("twice", np.float64),
        ("fourfold", np.float64),
        ("norm_once", np.float64),  # R over the sum of x over all places,
        ("norm_twice", np.float64),  # ... of x²
        ("norm_fourfold", np.float64),  # ... of x⁴
    ]
)
"""How a row of one frame turns into likelihoods: see :mod:`amusic_gym.estimation.belief.trust`."""


class Mind(Record):
    """Bookkeeping of one route's belief."""

    side: int  # which of the two buffers holds the belief
    frame: int  # last frame that it includes, -1 before the first
    steady: float  # belief in steady motion
    strange: float  # change of the rows over what is usual
    place: int  # whose surroundings hold most of the belief
    share: float  # how much of it
    rival: float  # share of the best surroundings apart from these
    said: float  # log-likelihood that the frame's rows gave the place, their sum
    heard: int  # number of these rows


class Witness(Record):
    """What is known of one technique on one route."""

    count: float  # rows seen
    last: int  # frame of the last one, -1: none
    weight: float  # of the present row, ≤ 1
    novelty: float  # running mean of 1 − correlation with the row before
    contrast: float  # running mean of the rows' deviation
    trust: float  # probability that its rows are informative, the sum of these:
    once: float  # probability that they are, with sharpness 1,
    twice: float  # ... 2
    fourfold: float  # ... 4
    place: int  # most probable place by this technique's row alone
    statistic: float  # its log-odds
    correction: float  # ... less those of the uncorrected match
    margin: float  # log of its probability over that of the best rival
    said: float  # log-likelihood that the row gave the place believed in


class Minds(Table):
    """Memory of the belief for a batch of N routes with S slots; two sets with re-selection.

    Arrays: ``minds`` (sets, N), ``witnesses`` (sets, N, S), ``belief`` (sets, N, 2, WAYS, REACH +
    R), ``hubs`` (sets, N, S, 2, R) mean and variance of each place's z-scores; scratch: ``rows``
    (S, R), ``voices`` (S,), ``prior``, ``joint`` and ``windows`` (R,); ``calibration`` (C,).
    """

    batch: Batch
    rates: Rates
    calibration: NDArray[np.float64] = array(np.float64, "coefficients")
    minds: NDArray[Any] = array(Mind, "sets", "routes")
    witnesses: NDArray[Any] = array(Witness, "sets", "routes", "slots")
    belief: NDArray[np.float64] = array(np.float64, "sets", "routes", "two", "ways", "line")
    hubs: NDArray[np.float64] = array(np.float64, "sets", "routes", "slots", "two", "references")
    rows: NDArray[np.float64] = array(np.float64, "slots", "references", kept=False)
    voices: NDArray[Any] = array(VOICE, "slots", kept=False)
    prior: NDArray[np.float64] = array(np.float64, "references", kept=False)
    joint: NDArray[np.float64] = array(np.float64, "references", kept=False)
    windows: NDArray[np.float64] = array(np.float64, "references", kept=False)

    def beside(self, active: NDArray[np.bool_]) -> Minds:
        """The same memory with scratch and active routes (N,) of its own, for another thread."""
        twin, twin_batch = copy.copy(self), copy.copy(self.batch)
        twin_batch.active = active
        twin.batch = twin_batch
        for name, column in self.columns.items():
            if not column.kept:
                setattr(twin, name, np.zeros_like(getattr(self, name)))
        return twin


minds_at: Any = reader(Minds)


def begin(minds: Minds, route: int, references: int) -> None:
    """Forget a route: every place is as likely, nothing is known of the techniques."""
    rates = minds.rates
    record = minds.minds[:, route]
    record[:] = np.zeros((), Mind.dtype)
    record["frame"], record["steady"] = -1, rates.steady
    known = minds.witnesses[:, route]
    known[:] = np.zeros((), Witness.dtype)
    known["last"] = -1
    known["once"], known["twice"], known["fourfold"] = first_trust(rates)
    known["trust"] = rates.trust
    known["place"] = -1
    minds.hubs[:, route, :, 0] = 0.0
    minds.hubs[:, route, :, 1] = 1.0
    belief = minds.belief[:, route]
    belief[:] = 0.0
    lines = np.array([share(rates, way) for way in range(WAYS)])
    belief[:, 0, :, REACH : REACH + references] = lines[:, None] / references


@apart
def copy_mind(minds: Minds, source: int, target: int, i: int) -> None:
    """Copy all that one set of the memory holds of route ``i`` to another set."""
    old, new = minds.minds[source, i], minds.minds[target, i]
    new.side, new.frame, new.steady, new.strange = old.side, old.frame, old.steady, old.strange
    for s in range(minds.witnesses.shape[2]):
        heard, hears = minds.witnesses[source, i, s], minds.witnesses[target, i, s]
        hears.count, hears.last, hears.weight = heard.count, heard.last, heard.weight
        hears.novelty, hears.contrast = heard.novelty, heard.contrast
        hears.trust, hears.once = heard.trust, heard.once
        hears.twice, hears.fourfold = heard.twice, heard.fourfold
        hears.place, hears.statistic = heard.place, heard.statistic
        hears.correction, hears.margin = heard.correction, heard.margin
        for kind in range(2):
            usual, kept = minds.hubs[source, i, s, kind], minds.hubs[target, i, s, kind]
            for place in range(usual.size):  # a loop: slices compile ten times as long
                kept[place] = usual[place]
    for side in range(2):
        for way in range(WAYS):
            line, twin = minds.belief[source, i, side, way], minds.belief[target, i, side, way]
            for place in range(line.size):
                twin[place] = line[place]
