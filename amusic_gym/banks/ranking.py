"""Ranked lists of places: the highest scores of a row."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

TOP = 20
"""Places of a ranked list, unless another number is asked for."""


def highest(row: NDArray[np.floating[Any]], count: int) -> NDArray[np.int64]:
    """Places of the highest scores of a row (R,), the best first, ties to the lower place.

    Args:
        row: scores; −∞ of a place that is no candidate.
        count: how many at most.

    Returns:
        (n,) int64, n ≤ ``count``: as many as there are candidates.
    """
    if count < len(row):
        least = np.partition(row, len(row) - count)[len(row) - count]
        places = np.flatnonzero((row >= least) & (row > -np.inf))
    else:
        places = np.flatnonzero(row > -np.inf)
    order = np.argsort(-row[places], kind="stable")[:count]
    return places[order]
