"""What policies that work on score rows themselves share: the rows, and their scaling."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.scores import floored
from amusic_gym.policies.protocol import Run

RADIUS = 20
"""R: places to either side of a match that count as the same one (Hausler 2019; Nordland 10)."""


def rows_of(run: Run, techniques: Sequence[int]) -> NDArray[np.float64]:
    """(n, R) rows of techniques, each of which is charged; see `floored`."""
    rows = np.stack([run(technique) for technique in techniques])
    return floored(rows.astype(np.float64))


def standardised(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows (..., R) to mean 0 and population σ 1; a constant row becomes zeros."""
    rows = floored(rows)
    centred = rows - rows.mean(axis=-1, keepdims=True)
    deviation = centred.std(axis=-1, keepdims=True)
    # Asked of the extremes, because rounding can leave a constant row a σ that is not quite 0.
    constant = rows.min(axis=-1, keepdims=True) == rows.max(axis=-1, keepdims=True)
    return np.where(constant, 0.0, centred / np.where(deviation > 0, deviation, 1.0))


def scaled(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows (..., R) so that the worst place has 0 and the best 1; a constant row becomes zeros."""
    lowest = rows.min(axis=-1, keepdims=True)
    span = rows.max(axis=-1, keepdims=True) - lowest
    return (rows - lowest) / np.where(span > 0, span, 1.0)
