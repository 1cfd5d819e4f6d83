"""From a score row to the likelihood of every place."""

from __future__ import annotations

import math
from typing import Any

from amusic_gym._compile import apart, inner
from amusic_gym.belief.rates import Rates
from amusic_gym.rows import mean_at, row_at, scale_at

RECENT = 0.1
"""Weight of the newest value in running means of novelty and contrast."""

DOUBT = 0.01
"""No row is trusted, or distrusted, beyond this."""


@inner
def power(value: float) -> float:
    """Exponential of numbers ≤ 0, to within 1 % above −4, never below 0.

    (1 + x/1024)^1024 by ten squarings: a loop of them runs in SIMD, which ``math.exp`` does not.
    """
    base = 1.0 + max(value, -60.0) * (1.0 / 1024.0)
    for _ in range(10):
        base *= base
    return base


@inner
def total(values: Any, size: int) -> float:
    """Sum of the first ``size`` values, in four lanes."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    even = size - size % 4
    for i in range(0, even, 4):
        a += values[i]
        b += values[i + 1]
        c += values[i + 2]
        d += values[i + 3]
    for i in range(even, size):
        a += values[i]
    return (a + b) + (c + d)


@inner
def product(left: Any, right: Any, size: int) -> float:
    """Sum of the products of the first ``size`` values, in four lanes."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    even = size - size % 4
    for i in range(0, even, 4):
        a += left[i] * right[i]
        b += left[i + 1] * right[i + 1]
        c += left[i + 2] * right[i + 2]
        d += left[i + 3] * right[i + 3]
    for i in range(even, size):
        a += left[i] * right[i]
    return (a + b) + (c + d)


@inner
def novelty_of(run: Any, frame: int, last: int) -> float:
    """1 − correlation of a technique's rows of two frames; −1 if one of them is constant."""
    row, before = row_at(run, frame), row_at(run, last)
    size = row.size
    scale = scale_at(run, frame)[0] * scale_at(run, last)[0]
    if scale == 0.0:
        return -1.0
    shift = mean_at(run, frame)[0]
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    even = size - size % 4
    for i in range(0, even, 4):
        a += (row[i] - shift) * before[i]
        b += (row[i + 1] - shift) * before[i + 1]
        c += (row[i + 2] - shift) * before[i + 2]
        d += (row[i + 3] - shift) * before[i + 3]
    for i in range(even, size):
        a += (row[i] - shift) * before[i]
    correlation: float = ((a + b) + (c + d)) * scale / size
    return min(max(1.0 - correlation, 0.0), 2.0)


@apart
def standardise(rates: Rates, run: Any, frame: int, count: float, hubs: Any, out: Any) -> None:
    """Write the row's z-scores, without what each place usually gets, to ``out``; learn of them."""
    row, mean, scale = row_at(run, frame), mean_at(run, frame)[0], scale_at(run, frame)[0]
    usual, spread = hubs[0], hubs[1]
    known = count / (count + rates.hub_count)
    shift, narrow = rates.hub * known, rates.hub_spread * known
    step = 1.0 / (min(count, rates.hub_memory) + 1.0) if scale > 0.0 else 0.0
    most = rates.most
    for place in range(row.size):
        z = (row[place] - mean) * scale
        centred = z - usual[place]
        variance = 1.0 + narrow * (spread[place] - 1.0)
        value = (z - shift * usual[place]) / math.sqrt(max(variance, 0.05))
        out[place] = min(max(value, -most), most)
        usual[place] += step * centred
        spread[place] += step * (centred * (z - usual[place]) - spread[place])


@apart
def listen(rates: Rates, known: Any, run: Any, frame: int, hubs: Any, out: Any) -> float:
    """Take in a technique's row: its standardised scores and weight; its novelty, −1 for none."""
    scale = scale_at(run, frame)[0]
    contrast = 1.0 / scale if scale > 0.0 else 0.0
    novelty = -1.0
    known.weight = 1.0 if scale > 0.0 else 0.0
    if known.last >= 0:
        novelty = novelty_of(run, frame, known.last)
        if novelty >= 0.0:
            known.weight *= rates.repeat + (1.0 - rates.repeat) * min(1.0, novelty / rates.novel)
        if contrast < known.contrast:
            known.weight *= (contrast / known.contrast) ** rates.contrast
        known.contrast += RECENT * (contrast - known.contrast)
    else:
        known.contrast = contrast
    standardise(rates, run, frame, known.count, hubs, out)
    return novelty


@apart
def likelihoods(rates: Rates, known: Any, prior: Any, size: int, row: Any) -> None:
    """Turn standardised scores into likelihoods in place, and learn how far to trust the technique.

    With the probability ``trust`` a row is informative and each place's likelihood is its softmax
    over the mean one; else it is 1 everywhere.
    """
    slope, bend = rates.sharpness * known.weight, rates.convexity
    highest = row[0]
    for place in range(size):
        highest = max(highest, row[place])
    top = slope * (highest + bend * max(highest, 0.0) * highest)
    for place in range(size):
        value = row[place]
        row[place] = power(min(slope * (value + bend * max(value, 0.0) * value) - top, 0.0))
    scale = size / total(row, size)
    fit = scale * product(prior, row, size)
    sure = product(prior, prior, size)
    trust = known.trust
    right = trust * fit / (1.0 - trust + trust * fit)
    weight = sure * known.weight
    learned = (trust * known.trusted + weight * right) / (known.trusted + weight)
    known.trust = min(max(learned, DOUBT), 1.0 - DOUBT)  # so no row ever rules a place out
    known.trusted = min(known.trusted + weight, rates.trust_memory)
    for place in range(size):
        row[place] = 1.0 - trust + trust * scale * row[place]
