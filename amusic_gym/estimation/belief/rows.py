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
from amusic_gym.kernels.compiling import apart, inner, larger, summing

single = np.float32
"""Of what is kept per place; numbers of a technique or a route are double."""

ZERO, ONE, LOWEST = single(0.0), single(1.0), single(-math.inf)


@summing
def total(values: NDArray[np.float32], size: int) -> float:
    """Sum of the first ``size`` values."""
    whole = ZERO
    for i in range(size):
        whole += values[i]
    return np.float64(whole)


@summing
def dot(one: NDArray[np.float32], other: NDArray[np.float32], size: int) -> float:
    """Sum of the products of the first ``size`` values."""
    whole = ZERO
    for i in range(size):
        whole += one[i] * other[i]
    return np.float64(whole)


@summing
def highest(values: NDArray[np.float32], size: int) -> np.float32:
    """Highest of the first ``size`` values; −∞ if there is none."""
    best = LOWEST
    for i in range(size):
        best = larger(best, values[i])
    return best


@inner
def power(value: np.float32) -> np.float32:
    """Exponential of numbers ≤ 0, to within 2e-5 above −11.

    (exp(x/64))^64 by a series and 6 squarings: a loop of them runs in SIMD, which ``math.exp`` does
    not.
    """
    x = max(value, single(-60.0)) * single(1 / 64)
    base = single(1 / 6) + x * (single(1 / 24) + x * single(1 / 120))
    base = ONE + x * (ONE + x * (single(1 / 2) + x * base))
    for _ in range(6):
        base *= base
    return base


@inner
def logarithm(value: np.float32) -> np.float32:
    """Logarithm of a positive number that is not subnormal; it runs in SIMD, too.

    From its bits as m 2ⁿ with 1 ≤ m < 2, and log m by a series in (m − √2) / (m + √2).
    """
    bits = np.float32(value).view(np.int32)
    exponent = single(np.int32((bits >> 23) & 0xFF)) - single(126.5)
    mantissa = np.int32((bits & 0x7FFFFF) | 0x3F800000).view(np.float32)
    u = (mantissa - single(math.sqrt(2.0))) / (mantissa + single(math.sqrt(2.0)))
    q = u * u
    series = single(2.0) + q * (single(2 / 3) + q * (single(2 / 5) + q * single(2 / 7)))
    return exponent * single(math.log(2.0)) + u * series


@inner
def note_news(known: TechniqueBelief, variance: float) -> None:
    """Compare the variance of a row's news with what is usual for its technique."""
    known.change = math.sqrt(variance / known.usual) if known.usual > 0.0 else 1.0
    if known.usual > 0.0:
        step = max(USUAL_STEP, 1.0 / (known.rows + 1.0)) * min(known.change, 1.0)
        known.usual += step * (min(variance, 4.0 * known.usual) - known.usual)
    elif known.rows > 0.0:
        known.usual = variance


@apart
def row_likelihood(
    known: TechniqueBelief,
    run: Run,
    frame: int,
    hub: NDArray[np.float32],
    variance: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the likelihood of every place, 1 on average, to ``out``; learn of the row.

    A place that is no candidate gets the floor, and has the mean score of all others.

    Args:
        known: of the technique; its ``news`` will be the factor on the row's scores, at most 1.
        run: of the technique; the row is prepared, and not constant.
        frame: of the row.
        hub: (R,) mean row.
        variance: (R,) of each place's news.
        out: (R,).
    """
    row, prepared = row_at(run, frame), prepared_at(run, frame)
    size, mean, scale = row.size, prepared.mean, prepared.scale
    if prepared.state == MASKED:
        for place in range(size):
            hub[place] = hub[place] if row[place] > LOWEST else ZERO
    for place in range(size):
        out[place] = single((row[place] - mean) * scale) if row[place] > LOWEST else ZERO
    own, common, hubs = dot(out, out, size), dot(out, hub, size), dot(hub, hub, size)
    share = min(max(common / math.sqrt(own * hubs + 1e-12), 0.0), 1.0)
    note_news(known, max(own - 2.0 * share * common + share * share * hubs, 0.0) / size)
    alike, least = single(share), single(LEAST_VARIANCE)
    step = single(HUB_STEP if known.rows > 0.0 else 1.0)
    spread = single(max(VARIANCE_STEP, 1.0 / (known.rows + 2.0)))
    known.rows += 1.0
    for place in range(size):
        z, usual = out[place], variance[place]
        news = z - alike * hub[place]
        hub[place] += step * (z - hub[place])
        variance[place] += spread * (news * news - usual)
        out[place] = news / math.sqrt(max(usual, least))
    average = total(out, size) / size
    deviation = math.sqrt(max(dot(out, out, size) / size - average * average, 0.0))
    known.news = math.sqrt(min(deviation, 1.0))
    slope, top = single(SLOPE * known.news / max(deviation, 1e-9)), highest(out, size)
    for place in range(size):
        out[place] = power(slope * (out[place] - top)) if row[place] > LOWEST else ZERO
    factor, floor = single((1.0 - FLOOR) * size / total(out, size)), single(FLOOR)
    for place in range(size):
        out[place] = factor * out[place] + floor
