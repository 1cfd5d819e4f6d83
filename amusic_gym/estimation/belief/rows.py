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

from amusic_gym.banks.rows import Run, mean_at, row_at, scale_at
from amusic_gym.estimation.belief.model import (
    FLOOR,
    HIGHEST,
    HUB_STEP,
    LEAST_VARIANCE,
    SLOPE,
    USUAL_STEP,
    VARIANCE_STEP,
)
from amusic_gym.estimation.belief.state import TechniqueBelief
from amusic_gym.kernels.compiling import apart, inner


@inner
def total(values: NDArray[np.float64], size: int) -> float:
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
def share_of_hub(run: Run, frame: int, hub: NDArray[np.float64], out: NDArray[np.float64]) -> float:
    """Correlation of a row with the mean row, from 0 to 1; its z-scores (R,) go to ``out``.

    A place that is no candidate has none there, and 0 in ``out``.
    """
    row, mean, scale = row_at(run, frame), mean_at(run, frame)[0], scale_at(run, frame)[0]
    product, square, of_hub = 0.0, 0.0, 1e-12
    for place in range(row.size):
        z = (row[place] - mean) * scale if row[place] != -math.inf else 0.0
        out[place] = z
    for place in range(row.size):
        product += out[place] * hub[place]
        square += out[place] * out[place]
        of_hub += hub[place] * hub[place]
    return min(max(product / math.sqrt(square * of_hub), 0.0), 1.0)


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
    hub: NDArray[np.float64],
    variance: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Write the likelihood of every place, 1 on average, to ``out``; learn of the row.

    A place that is no candidate gets the floor, and nothing is learned of it.

    Args:
        known: of the technique; its ``news`` will be the factor on the row's scores, at most 1.
        run: of the technique; the row is prepared, and not constant.
        frame: of the row.
        hub: (R,) mean row.
        variance: (R,) of each place's news.
        out: (R,).
    """
    row = row_at(run, frame)
    size = row.size
    alike = share_of_hub(run, frame, hub, out)
    step = HUB_STEP if known.rows > 0.0 else 1.0
    spread, square = max(VARIANCE_STEP, 1.0 / (known.rows + 2.0)), 0.0
    for place in range(size):
        candidate = 1.0 if row[place] != -math.inf else 0.0
        z = out[place]
        news = candidate * (z - alike * hub[place])
        square += news * news
        hub[place] += candidate * step * (z - hub[place])
        out[place] = news / math.sqrt(max(variance[place], LEAST_VARIANCE))
        variance[place] += candidate * spread * (news * news - variance[place])
    note_news(known, square / size)
    known.rows += 1.0
    mean, square = total(out, size) / size, 0.0
    for place in range(size):
        square += (out[place] - mean) * (out[place] - mean)
    deviation = math.sqrt(square / size)
    known.news = math.sqrt(min(deviation, 1.0))
    scale = SLOPE * known.news / max(deviation, 1e-9)
    for place in range(size):
        out[place] = math.exp(scale * min(out[place] - mean, HIGHEST * deviation))
    candidates = 0.0
    for place in range(size):
        if row[place] == -math.inf:
            out[place] = 0.0
        else:
            candidates += 1.0
    factor = (1.0 - FLOOR) * candidates / total(out, size)
    for place in range(size):
        out[place] = factor * out[place] + FLOOR
