"""What the belief remembers of a batch of routes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import RUN
from amusic_gym.estimation.belief.rates import RATES, WAYS, Rates, first_trust, share
from amusic_gym.estimation.records import MIND, ROUTE, SLOT, WITNESS
from amusic_gym.kernels.compiling import apart
from amusic_gym.kernels.tables import Layout, reader

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

    def beside(self) -> Minds:
        """The same memory with scratch of its own, for another thread."""
        scratch = ("rows", "voices", "prior", "joint", "windows")
        return self._replace(**{name: np.zeros_like(getattr(self, name)) for name in scratch})


MINDS = Layout(
    "Minds",
    {
        "rates": RATES,
        "minds": (MIND, 2),
        "witnesses": (WITNESS, 3),
        "belief": (np.float64, 5),
        "hubs": (np.float64, 5),
        "rows": (np.float64, 2),
        "voices": (VOICE, 1),
        "prior": (np.float64, 1),
        "joint": (np.float64, 1),
        "windows": (np.float64, 1),
    },
)
"""How kernels see :class:`Minds`."""

minds_at: Any = reader(MINDS)


class Hearing(NamedTuple):
    """What the belief of N routes reads and writes at a step."""

    minds: Minds
    active: NDArray[np.bool_]  # (N,) routes that hear their next frame
    wanted: NDArray[np.bool_]  # (N,) routes that look back
    lagging: NDArray[np.bool_]  # (N,) routes whose lagged belief cannot wait: their rows go
    block: int  # M
    routes: NDArray[Any]  # (N,) ROUTE: the last frame processed, and the tolerance
    slots: NDArray[Any]  # (N, S) SLOT: whether a technique is present
    runs: NDArray[Any]  # (N, S) RUN
    ran: NDArray[np.uint8]  # (N, S, Q), filled in for the next frame
    late: NDArray[np.int64]  # (N, S) filled with the runs after the fact
    statistics: NDArray[np.float64]  # (N, M, S) filled with the statistics on the block's frames
    corrections: NDArray[np.float64]  # (N, S, M) likewise with the corrections


HEARING = Layout(
    "Hearing",
    {
        "minds": MINDS,
        "active": (np.bool_, 1),
        "wanted": (np.bool_, 1),
        "lagging": (np.bool_, 1),
        "block": int,
        "routes": (ROUTE, 1),
        "slots": (SLOT, 2),
        "runs": (RUN, 2),
        "ran": (np.uint8, 3),
        "late": (np.int64, 2),
        "statistics": (np.float64, 3),
        "corrections": (np.float64, 3),
    },
)
"""How kernels see a :class:`Hearing`."""

hearing_at: Any = reader(HEARING)


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
