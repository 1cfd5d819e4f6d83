"""Where the belief lies: sums over the places within the tolerance of each."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.belief.model import ENOUGH, SURE
from amusic_gym.estimation.belief.rows import highest, total
from amusic_gym.estimation.belief.state import BeliefState, RouteBelief, TechniqueBelief
from amusic_gym.kernels.compiling import apart, inner


@apart
def window_sums(
    values: NDArray[np.float64], size: int, tolerance: int, out: NDArray[np.float64]
) -> None:
    """Sums of ``values`` within the tolerance of each place."""
    within, wide = 0.0, 2 * tolerance + 1
    for place in range(min(tolerance, size)):
        within += values[place]
    for place in range(size):
        if place < tolerance + 1 or place + tolerance >= size:
            within += values[place + tolerance] if place + tolerance < size else 0.0
            within -= values[place - tolerance - 1] if place > tolerance else 0.0
            out[place] = within
        else:
            within += values[place + tolerance] - values[place + tolerance - wide]
            out[place] = within


@inner
def first_highest(values: NDArray[np.float64], size: int) -> int:
    """Place of the highest value; of (almost) equal ones the first."""
    enough = highest(values, 0, size) * (1.0 - 1e-9)
    for place in range(size):
        if values[place] >= enough:
            return place
    return 0


@apart
def likeliest(
    values: NDArray[np.float64], windows: NDArray[np.float64], size: int, tolerance: int
) -> int:
    """Place that holds most of those whose surroundings hold (almost) most.

    Without it, a belief narrower than the tolerance would be placed anywhere within it.
    """
    best = first_highest(windows, size)
    enough, place = ENOUGH * windows[best], best
    for c in range(max(best - tolerance, 0), min(best + tolerance + 1, size)):
        if windows[c] >= enough and values[c] > values[place] * (1.0 + 1e-9):
            place = c
    return place


@inner
def rival_window(windows: NDArray[np.float64], size: int, place: int, tolerance: int) -> float:
    """Highest sum of a window that shares no place with that of ``place``; 0: there is none."""
    before = highest(windows, 0, place - 2 * tolerance)
    return max(before, highest(windows, place + 2 * tolerance + 1, size), 0.0)


@inner
def log_odds(share: float) -> float:
    """Log-odds of a probability, kept finite."""
    return math.log(max(share, SURE)) - math.log(max(1.0 - share, SURE))


@inner
def log_ratio(share: float, rival: float) -> float:
    """Logarithm of the ratio of two probabilities, kept finite."""
    return math.log(max(share, SURE)) - math.log(max(rival, SURE))


@apart
def single_technique_posterior(
    state: BeliefState, known: TechniqueBelief, s: int, top: int, size: int, tolerance: int
) -> None:
    """What one technique's row alone makes of the belief: its place, statistic, correction, margin.

    Args:
        state: ``prior`` is the belief before the frame, ``likelihoods[s]`` that of the row.
        known: where they go.
        s: the technique's slot.
        top: the row's best place.
        size: R.
        tolerance: places off that still count as true.
    """
    joint, windows, likelihood = state.joint, state.windows, state.likelihoods[s]
    for place in range(size):
        joint[place] = state.prior[place] * likelihood[place]
    window_sums(joint, size, tolerance, windows)
    whole = total(joint, size)
    known.place = likeliest(joint, windows, size, tolerance)
    share = windows[known.place] / whole
    known.statistic = log_odds(share)
    known.correction = max(known.statistic - log_odds(windows[top] / whole), 0.0)
    known.margin = log_ratio(share, rival_window(windows, size, known.place, tolerance) / whole)


@apart
def marginalise(state: BeliefState, route: RouteBelief, size: int, tolerance: int) -> None:
    """Find the place whose window holds most of the belief, ``joint``, and its rival."""
    window_sums(state.joint, size, tolerance, state.windows)
    whole = total(state.joint, size)
    route.place = likeliest(state.joint, state.windows, size, tolerance)
    route.share = min(state.windows[route.place] / whole, 1.0)
    route.rival = rival_window(state.windows, size, route.place, tolerance) / whole
