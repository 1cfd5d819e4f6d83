"""The rates of the belief: what it takes for granted of robots and techniques."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from numba import types

from amusic_gym.kernels.compiling import inner
from amusic_gym.kernels.tables import Layout

SPEEDS = 5
"""Ways of moving with jumps: 0, 0.5, 1, 1.5 and 2 places per frame."""

LOCKED = SPEEDS
"""Steady motion, one place per frame, in which images look like the true place."""

WANDER = 3
"""Most places that images look ahead or behind in steady motion that wanders."""

WAYS = SPEEDS + 1 + 2 * WANDER + 1
"""Lines of the belief: the speeds, locked steady motion, wandering from −3 to +3 places."""

SHARES = (0.125, 0.125, 0.5, 0.125, 0.125)
"""How often each speed is drawn."""

FILE = "rates.json"


class Rates(NamedTuple):
    """What the filter takes for granted; fitted on simulated routes."""

    sharpness: float  # log-likelihood per unit of a standardised score
    convexity: float  # how much more the far upper tail says
    most: float  # standardised scores are clipped to ±this
    trust: float  # probability that a technique's rows are informative, before any is known
    sharper: float  # share of the informative that are twice as sharp, or more
    sharpest: float  # share of these that are four times as sharp
    learn: float  # exponent of what a row says of its technique
    relearn: float  # chance per row that how sharp it is is drawn anew
    hub: float  # share of a place's mean that is taken out
    hub_spread: float  # share of a place's variance that is taken out
    hub_count: float  # rows that mean 0 and variance 1 are worth
    hub_memory: float  # rows that are remembered at most
    novel: float  # 1 − correlation with the last row from which a row counts in full
    repeat: float  # weight of an exact repetition
    contrast: float  # exponent of the row's deviation over its running mean
    stand: float  # how much likelier standing is where the rows stay the same
    jump: float  # chance of a jump per frame
    jump_novel: float  # log of its growth per unit of novelty ...
    jump_usual: float  # ... above so many times the usual
    change: float  # chance of a new speed per frame
    slack: float  # chance to move one place less or more than the speed says
    steady: float  # belief in steady motion at the start
    steady_jump: float
    wandering: float  # share of it in which images look ahead or behind
    wander: float  # how fast that changes: chance of a step per frame, at most
    leave: float  # chance per frame that steady motion ends
    settle: float  # chance per frame that it begins


RATES = Layout("Rates", dict.fromkeys(Rates._fields, types.float64))
Rates.layout = RATES  # type: ignore[attr-defined]
"""How kernels see :class:`Rates`."""

BINOMIAL = (1 / 64, 6 / 64, 15 / 64, 20 / 64, 15 / 64, 6 / 64, 1 / 64)
"""How often images look −3 … +3 places off, in the long run."""


def share(rates: Rates, way: int) -> float:
    """Belief in a way of moving before anything is seen."""
    if way < SPEEDS:
        value = (1.0 - rates.steady) * SHARES[way]
    elif way == LOCKED:
        value = rates.steady * (1.0 - rates.wandering)
    else:
        value = rates.steady * rates.wandering * BINOMIAL[way - LOCKED - 1]
    return value


def first_trust(rates: Rates) -> tuple[float, float, float]:
    """Probabilities that a technique's rows are informative with sharpness 1, 2 and 4, at first."""
    sharper = rates.trust * rates.sharper
    sharpest = sharper * rates.sharpest
    return rates.trust - sharper, sharper - sharpest, sharpest


share_of = inner(share)
trust_of = inner(first_trust)


@cache
def stored() -> dict[str, Any]:
    """What ``scripts/fit_belief.py`` wrote."""
    table: dict[str, Any] = json.loads(
        files("amusic_gym.estimation.belief").joinpath(FILE).read_text("utf-8")
    )
    return table


def fitted() -> Rates:
    """The rates that ship."""
    return Rates(**stored()["rates"])
