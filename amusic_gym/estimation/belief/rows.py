"""From a score row to the likelihood of every place.

A technique's errors last for many frames: the same wrong places score high again and again. So a
row counts by its news: its z-scores less the technique's mean row of late, as far as the two are
correlated, over the deviation that each place's news usually has. That the likelihood then grows by
a factor of e^SLOPE per standard deviation, and does not fall below a floor, is what the true
places of recordings show, for every technique alike.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import MASKED, Run, prepared_at, row_at
from amusic_gym.estimation.belief.model import (
    FLOOR,
    HUB_STEP,
    LEAST_VARIANCE,
    SLOPE,
    USUAL_STEP,
    VARIANCE_STEP,
)
from amusic_gym.estimation.belief.state import TechniqueBelief
from amusic_gym.kernels.compiling import apart, inner

LOG_FLOOR = math.log(FLOOR)


@inner
def total(values: NDArray[np.float64], size: int) -> float:
    """Sum of the first ``size`` values; in four lanes, because additions of one chain wait."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for four in range(size // 4):
        first = np.uintp(4 * four)  # unsigned: no check for a negative index
        a += values[first]
        b += values[first + np.uintp(1)]
        c += values[first + np.uintp(2)]
        d += values[first + np.uintp(3)]
    for i in range(size - size % 4, size):
        a += values[i]
    return (a + b) + (c + d)


@inner
def dot(one: NDArray[np.float64], other: NDArray[np.float64], size: int) -> float:
    """Sum of the products of the first ``size`` values, likewise."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for four in range(size // 4):
        first = np.uintp(4 * four)
        a += one[first] * other[first]
        b += one[first + np.uintp(1)] * other[first + np.uintp(1)]
        c += one[first + np.uintp(2)] * other[first + np.uintp(2)]
        d += one[first + np.uintp(3)] * other[first + np.uintp(3)]
    for i in range(size - size % 4, size):
        a += one[i] * other[i]
    return (a + b) + (c + d)


@inner
def highest(values: NDArray[np.float64], first: int, stop: int) -> float:
    """Highest of the values from ``first`` to before ``stop``; −∞ if there is none."""
    a, b, c, d = -math.inf, -math.inf, -math.inf, -math.inf
    fours = max(stop - first, 0) // 4
    for four in range(fours):
        at = np.uintp(first + 4 * four)
        a = max(a, values[at])
        b = max(b, values[at + np.uintp(1)])
        c = max(c, values[at + np.uintp(2)])
        d = max(d, values[at + np.uintp(3)])
    for i in range(first + 4 * fours, stop):
        a = max(a, values[i])
    return max(max(a, b), max(c, d))


@inner
def power(value: float) -> float:
    """Exponential of numbers ≤ 0, to within 0.1 % above −11.

    (1 + x/65536)^65536 by 16 squarings: a loop of them runs in SIMD, which ``math.exp`` does not.
    """
    base = 1.0 + max(value, -60.0) * (1.0 / 65536.0)
    for _ in range(16):
        base *= base
    return base


@inner
def note_news(known: TechniqueBelief, variance: float) -> None:
    """Compare the variance of a row's news with what is usual for its technique."""
    known.change = math.sqrt(variance / known.usual) if known.usual > 0.0 else 1.0
    if known.usual > 0.0:
        step = max(USUAL_STEP, 1.0 / (known.rows + 1.0)) * min(known.change, 1.0)
        known.usual += step * (min(variance, 4.0 * known.usual) - known.usual)
    elif known.rows > 0.0:
        known.usual = variance


@inner
def standardise(run: Run, frame: int, hub: NDArray[np.float64], out: NDArray[np.float64]) -> bool:
    """Write a row's z-scores (R,) to ``out``; whether places are no candidates.

    These have 0 there and in the mean row.
    """
    row, prepared = row_at(run, frame), prepared_at(run, frame)
    mean, scale = prepared.mean, prepared.scale
    masked: bool = prepared.state == MASKED
    for place in range(row.size):
        out[place] = (row[place] - mean) * scale
    if masked:
        for place in range(row.size):
            if row[place] == -math.inf:
                out[place] = hub[place] = 0.0
    return masked


@apart
def row_likelihood(
    known: TechniqueBelief,
    run: Run,
    frame: int,
    hub: NDArray[np.float64],
    variance: NDArray[np.float64],
    out: NDArray[np.float64],
    logs: NDArray[np.float64],
) -> float:
    """Write the likelihood of every place, 1 on average, to ``out``; learn of the row.

    A place that is no candidate gets the floor, and has the mean score of all others.

    Args:
        known: of the technique; its ``news`` will be the factor on the row's scores, at most 1.
        run: of the technique; the row is prepared, and not constant.
        frame: of the row.
        hub: (R,) mean row.
        variance: (R,) of each place's news.
        out: (R,).
        logs: (R,) filled for :func:`take_logs`.

    Returns:
        The shift that goes with ``logs``.
    """
    row = row_at(run, frame)
    size = row.size
    masked = standardise(run, frame, hub, out)
    own, common, hubs = dot(out, out, size), dot(out, hub, size), dot(hub, hub, size)
    alike = min(max(common / math.sqrt(own * hubs + 1e-12), 0.0), 1.0)
    note_news(known, max(own - 2.0 * alike * common + alike * alike * hubs, 0.0) / size)
    step = HUB_STEP if known.rows > 0.0 else 1.0
    spread = max(VARIANCE_STEP, 1.0 / (known.rows + 2.0))
    for place in range(size):
        z, usual = out[place], variance[place]
        news = z - alike * hub[place]
        hub[place] += step * (z - hub[place])
        variance[place] += spread * (news * news - usual)
        out[place] = news / math.sqrt(max(usual, LEAST_VARIANCE))
    known.rows += 1.0
    average = total(out, size) / size
    for place in range(size):
        out[place] -= average
    deviation = math.sqrt(dot(out, out, size) / size)
    known.news = math.sqrt(min(deviation, 1.0))
    slope, top = SLOPE * known.news / max(deviation, 1e-9), highest(out, 0, size)
    for place in range(size):
        logs[place] = slope * (out[place] - top)
        out[place] = power(logs[place])
    if masked:
        for place in range(size):
            if row[place] == -math.inf:
                out[place], logs[place] = 0.0, -math.inf
    factor = (1.0 - FLOOR) * size / total(out, size)
    for place in range(size):
        out[place] = factor * out[place] + FLOOR
    return math.log(factor / FLOOR)


@apart
def take_logs(shift: float, size: int, logs: NDArray[np.float64]) -> None:
    """Turn what :func:`row_likelihood` left in ``logs`` (R,) into log-likelihoods.

    log(F + f eˣ) = log F + max(d, 0) + log(1 + e^−|d|) with d = x + log(f / F), the last logarithm
    by its series in e^−|d| / (2 + e^−|d|), which runs in SIMD.
    """
    for place in range(size):
        excess = logs[place] + shift
        rest = power(-abs(excess))
        u = rest / (2.0 + rest)
        q = u * u
        series = 1 / 9 + q * (1 / 11 + q * (1 / 13 + q * (1 / 15)))
        series = 1.0 + q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * series)))
        logs[place] = LOG_FLOOR + max(excess, 0.0) + 2.0 * u * series
