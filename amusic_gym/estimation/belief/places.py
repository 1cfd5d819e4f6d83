"""Where the belief lies: sums over the places within the tolerance of each."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.belief.model import ENOUGH, SURE
from amusic_gym.estimation.belief.rows import ZERO, highest, single, total
from amusic_gym.estimation.belief.state import BeliefState, RouteBelief, TechniqueBelief
from amusic_gym.kernels.compiling import apart, inner
from amusic_gym.kernels.tables import part

LESS = single(1.0 - 1e-6)  # times it, a number is below all that differ by rounding only


@apart
def window_sums(
    values: NDArray[np.float32],
    size: int,
    tolerance: int,
    lines: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Sums of ``values`` (R,) within the tolerance of each place.

    By sums of 1, 2, 4, … places: differences of running sums would round small ones away.
    """
    around = min(tolerance, size - 1)
    long, wide = size + 2 * around, 2 * around + 1
    now, later = lines[0], lines[1]
    for c in range(around):
        now[c] = now[around + size + c] = ZERO
    middle = part(now, around, size)
    for c in range(size):
        middle[c] = values[c]
    for c in range(size):
        out[c] = now[c]
    done, width = 1, 1
    while 2 * width <= wide:
        long -= width
        ahead = part(now, width, long)
        for c in range(long):
            later[c] = now[c] + ahead[c]
        now, later, width = later, now, 2 * width
        if wide & width:
            more = part(now, done, size)
            for c in range(size):
                out[c] += more[c]
            done += width


@inner
def first_highest(values: NDArray[np.float32], size: int) -> int:
    """Place of the highest value; of (almost) equal ones the first."""
    enough = highest(values, size) * LESS
    for place in range(size):
        if values[place] >= enough:
            return place
    return 0


@apart
def likeliest(
    values: NDArray[np.float32], windows: NDArray[np.float32], size: int, tolerance: int
) -> int:
    """Place that holds most of those whose surroundings hold (almost) most.

    Without it, a belief narrower than the tolerance would be placed anywhere within it.
    """
    best = first_highest(windows, size)
    enough, place = ENOUGH * windows[best], best
    for c in range(max(best - tolerance, 0), min(best + tolerance + 1, size)):
        if windows[c] >= enough and values[c] * LESS > values[place]:
            place = c
    return place


@inner
def share_at(
    values: NDArray[np.float32],
    windows: NDArray[np.float32],
    place: int,
    size: int,
    tolerance: int,
) -> float:
    """Share of a place's window; as far below 1 as the other places hold, be it ever so little."""
    before, after = max(place - tolerance, 0), max(size - place - tolerance - 1, 0)
    rest = total(values, before) + total(part(values, size - after, after), after)
    return 1.0 / (1.0 + rest / np.float64(windows[place]))


@inner
def rival_window(windows: NDArray[np.float32], size: int, place: int, tolerance: int) -> float:
    """Highest sum of a window that shares no place with that of ``place``; 0: there is none."""
    before, after = max(place - 2 * tolerance, 0), max(size - place - 2 * tolerance - 1, 0)
    best = max(highest(windows, before), highest(part(windows, size - after, after), after))
    return np.float64(max(best, ZERO))


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
    window_sums(joint, size, tolerance, state.lines, windows)
    known.place = likeliest(joint, windows, size, tolerance)
    share = share_at(joint, windows, known.place, size, tolerance)
    known.statistic, known.correction = log_odds(share), 0.0
    if top != known.place:
        raw = log_odds(share_at(joint, windows, top, size, tolerance))
        known.correction = max(known.statistic - raw, 0.0)
    rival = rival_window(windows, size, known.place, tolerance)
    known.margin = log_ratio(share, share * rival / windows[known.place])


@apart
def marginalise(state: BeliefState, route: RouteBelief, size: int, tolerance: int) -> None:
    """Find the place whose window holds most of the belief, ``joint``, and its rival."""
    joint, windows = state.joint, state.windows
    window_sums(joint, size, tolerance, state.lines, windows)
    route.place = likeliest(joint, windows, size, tolerance)
    route.share = share_at(joint, windows, route.place, size, tolerance)
    rival = rival_window(windows, size, route.place, tolerance)
    route.rival = route.share * rival / windows[route.place]
