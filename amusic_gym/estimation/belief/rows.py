"""A score row, standardised: without hubs, and with how much it weighs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from amusic_gym.banks.rows import MASKED, masked_correlation, mean_at, ready_at, row_at, scale_at
from amusic_gym.estimation.belief.rates import Rates
from amusic_gym.kernels.compiling import apart, inner

RECENT = 0.1
"""Weight of the newest value in running means of novelty and contrast."""

NOWHERE = -1000.0
"""Standardised score of a place that is no candidate."""


@inner
def total(values: Any, size: int) -> float:
    """Sum of the first ``size`` values, in four lanes."""
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


@apart
def novelty_of(run: Any, frame: int, last: int) -> float:
    """1 − correlation of a technique's rows of two frames; −1 if one of them is constant."""
    row, before = row_at(run, frame), row_at(run, last)
    size = row.size
    scale = scale_at(run, frame)[0] * scale_at(run, last)[0]
    if scale == 0.0:
        return -1.0
    if ready_at(run, frame)[0] == MASKED or ready_at(run, last)[0] == MASKED:
        return min(max(1.0 - masked_correlation(run, last, run, frame, 0), 0.0), 2.0)
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
    """Write the row's z-scores, without what each place usually gets, to ``out``; learn of them.

    A place that is no candidate gets `NOWHERE`, and nothing is learned of it.
    """
    row, mean, scale = row_at(run, frame), mean_at(run, frame)[0], scale_at(run, frame)[0]
    usual, spread = hubs[0], hubs[1]
    known = count / (count + rates.hub_count)
    shift, narrow = rates.hub * known, rates.hub_spread * known
    step = 1.0 / (min(count, rates.hub_memory) + 1.0) if scale > 0.0 else 0.0
    most = rates.most
    for place in range(row.size):
        if row[place] == -math.inf:
            out[place] = NOWHERE if scale > 0.0 else 0.0
            continue
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
