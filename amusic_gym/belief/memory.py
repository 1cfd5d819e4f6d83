"""What the belief remembers of a batch of routes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym._compile import apart
from amusic_gym.belief.rates import WAYS, Rates, share_of, trust_of

REACH = 3
"""Most places that one frame moves, slack included; the arrays begin with so many zeros."""

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
"""How a row of one frame turns into likelihoods: see :mod:`amusic_gym.belief.trust`."""


class Minds(NamedTuple):
    """Memory of a batch of N routes with S slots; ``sets`` is 2 with re-selection, else 1."""

    rates: Rates
    minds: NDArray[Any]  # (sets, N) MIND
    witnesses: NDArray[Any]  # (sets, N, S) WITNESS
    belief: NDArray[np.float64]  # (sets, N, 2, WAYS, REACH + R)
    hubs: NDArray[np.float64]  # (sets, N, S, 2, R): mean and variance of each place's z-scores
    rows: NDArray[np.float64]  # (S, R) scratch: standardised rows, then e to their power
    voices: NDArray[Any]  # (S,) VOICE scratch
    prior: NDArray[np.float64]  # (R,) scratch
    joint: NDArray[np.float64]  # (R,) scratch: the belief over places, all ways of moving
    windows: NDArray[np.float64]  # (R,) scratch: sums of the belief within the tolerance


def allocate(rates: Rates, sets: int, routes: int, slots: int, references: int) -> Minds:
    """Memory for a batch of routes on maps of at most ``references`` places."""
    return Minds(
        rates=rates,
        minds=np.zeros((sets, routes), MIND),
        witnesses=np.zeros((sets, routes, slots), WITNESS),
        belief=np.zeros((sets, routes, 2, WAYS, REACH + references)),
        hubs=np.zeros((sets, routes, slots, 2, references)),
        rows=np.zeros((slots, references)),
        voices=np.zeros(slots, VOICE),
        prior=np.zeros(references),
        joint=np.zeros(references),
        windows=np.zeros(references),
    )


def begin(minds: Minds, route: int, references: int) -> None:
    """Forget a route: every place is as likely, nothing is known of the techniques."""
    rates = minds.rates
    record = minds.minds[:, route]
    record[:] = np.zeros((), MIND)
    record["frame"], record["steady"] = -1, rates.steady
    known = minds.witnesses[:, route]
    known[:] = np.zeros((), WITNESS)
    known["last"] = -1
    known["once"], known["twice"], known["fourfold"] = trust_of(rates)
    known["trust"] = rates.trust
    known["place"] = -1
    minds.hubs[:, route, :, 0] = 0.0
    minds.hubs[:, route, :, 1] = 1.0
    belief = minds.belief[:, route]
    belief[:] = 0.0
    lines = np.array([share_of(rates, way) for way in range(WAYS)])
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
