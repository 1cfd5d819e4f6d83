"""Where the belief lies: sums over ways of moving and over places within the tolerance."""

from __future__ import annotations

import math
from typing import Any

from amusic_gym.estimation.belief.memory import REACH, Minds
from amusic_gym.estimation.belief.rates import LOCKED, WANDER, WAYS
from amusic_gym.estimation.belief.trust import likelihood
from amusic_gym.kernels.compiling import apart, inner
from amusic_gym.kernels.tables import part

SURE = 1e-12
"""The least probability that a logarithm is taken of."""

ENOUGH = 0.99
"""Surroundings that hold this share of the most that any do are as good."""


@apart
def places_of(belief: Any, size: int, out: Any) -> None:
    """Belief over true places, whatever the way of moving."""
    for c in range(size):
        out[c] = belief[0, REACH + c]
    for way in range(1, WAYS):
        line = part(belief[way], REACH, size)
        for c in range(size):
            out[c] += line[c]


@inner
def inside(off: int, size: int) -> tuple[int, int]:
    """Range of places from which a look ``off`` places ahead stays on the map.

    What would look beyond an end looks like that end.
    """
    low = min(max(-off, 0), size)
    return low, max(min(size - off, size), low)


@apart
def looks_of(belief: Any, size: int, out: Any) -> None:
    """Belief over the places that the image looks like."""
    for c in range(size):
        out[c] = belief[0, REACH + c]
    for way in range(1, LOCKED + 1):
        line = part(belief[way], REACH, size)
        for c in range(size):
            out[c] += line[c]
    for way in range(LOCKED + 1, WAYS):
        line, off = belief[way], way - LOCKED - 1 - WANDER
        low, high = inside(off, size)
        for c in range(low):
            out[0] += line[REACH + c]
        looks, held = part(out, low + off, high - low), part(line, REACH + low, high - low)
        for c in range(high - low):
            looks[c] += held[c]
        for c in range(high, size):
            out[size - 1] += line[REACH + c]


@apart
def weigh_places(belief: Any, factor: Any, size: int) -> None:
    """Multiply every line by the likelihood of the place that it takes the image to look like."""
    for way in range(LOCKED + 1):
        line = part(belief[way], REACH, size)
        for c in range(size):
            line[c] *= factor[c]
    for way in range(LOCKED + 1, WAYS):
        line, off = belief[way], way - LOCKED - 1 - WANDER
        low, high = inside(off, size)
        for c in range(low):
            line[REACH + c] *= factor[0]
        looks, held = part(factor, low + off, high - low), part(line, REACH + low, high - low)
        for c in range(high - low):
            held[c] *= looks[c]
        for c in range(high, size):
            line[REACH + c] *= factor[size - 1]


@apart
def rescale(factor: Any, size: int) -> None:
    """Divide by the highest, so that a product of more factors neither vanishes nor overflows."""
    most = 0.0
    for place in range(size):
        most = max(most, factor[place])
    for place in range(size):
        factor[place] /= most


@apart
def window_sums(values: Any, size: int, tolerance: int, out: Any) -> float:
    """Sums of ``values`` within the tolerance of each place; returns the sum of all values."""
    within, whole = 0.0, 0.0
    for place in range(min(tolerance, size)):
        within += values[place]
    for place in range(size):
        whole += values[place]
        if place + tolerance < size:
            within += values[place + tolerance]
        if place > tolerance:
            within -= values[place - tolerance - 1]
        out[place] = within
    return whole


@inner
def best_window(windows: Any, size: int) -> int:
    """Place of the highest window sum; of equal ones the first."""
    best = 0
    for place in range(1, size):
        if windows[place] > windows[best] * (1.0 + 1e-9):
            best = place
    return best


@apart
def likeliest(values: Any, windows: Any, size: int, tolerance: int) -> int:
    """Place that holds most of those whose surroundings hold (almost) most.

    Without it, a belief narrower than the tolerance would be placed anywhere within it.
    """
    best = best_window(windows, size)
    enough, place = ENOUGH * windows[best], best
    for c in range(max(best - tolerance, 0), min(best + tolerance + 1, size)):
        if windows[c] >= enough and values[c] > values[place] * (1.0 + 1e-9):
            place = c
    return place


@apart
def rival_window(windows: Any, size: int, place: int, tolerance: int) -> float:
    """Highest sum of a window that shares no place with that of ``place``; 0: there is none."""
    rival = 0.0
    for c in range(max(place - 2 * tolerance, 0)):
        rival = max(rival, windows[c])
    for c in range(place + 2 * tolerance + 1, size):
        rival = max(rival, windows[c])
    return rival


@inner
def log_odds(share: float) -> float:
    """Log-odds of a probability, kept finite."""
    return math.log(max(share, SURE)) - math.log(max(1.0 - share, SURE))


@inner
def log_ratio(share: float, rival: float) -> float:
    """Logarithm of the ratio of two probabilities, kept finite."""
    return math.log(max(share, SURE)) - math.log(max(rival, SURE))


@apart
def testify(
    known: Any,
    prior: Any,
    row: Any,
    words: Any,
    top: int,
    size: int,
    tolerance: int,
    joint: Any,
    windows: Any,
) -> None:
    """What the technique alone makes of the belief: its place, statistic and correction."""
    for place in range(size):
        joint[place] = prior[place] * likelihood(words, row[place])
    whole = window_sums(joint, size, tolerance, windows)
    best = likeliest(joint, windows, size, tolerance)
    known.place = best
    known.statistic = log_odds(windows[best] / whole)
    known.correction = max(known.statistic - log_odds(windows[top] / whole), 0.0)
    known.margin = log_ratio(
        windows[best] / whole, rival_window(windows, size, best, tolerance) / whole
    )


@apart
def conclude(minds: Minds, mind: Any, size: int, tolerance: int, whole: float) -> None:
    """Find the place whose surroundings hold most of the belief, and its rival."""
    windows = minds.windows
    window_sums(minds.joint, size, tolerance, windows)
    mind.place = likeliest(minds.joint, windows, size, tolerance)
    mind.share = min(windows[mind.place] / whole, 1.0)
    mind.rival = rival_window(windows, size, mind.place, tolerance) / whole
