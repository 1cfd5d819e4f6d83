"""Fronts of AUC against compute as step functions, their hypervolume and their differences.

A front says: the best AUC at no more than that compute. All functions take the P points of a
front in the last axis; axes before it are copies of the whole, such as bootstrap replicates.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

GRID = np.geomspace(0.01, 1.0, 101)
"""Computes at which fronts are compared: 1 % to 100 %, each 4.7 % dearer than the one before."""

BAND = (0.05, 0.4)  # compute between which a selector must be ahead somewhere
REFERENCE_AUC = 0.5  # of the hypervolume: what lies below this AUC counts for nothing
ROUNDING = 1e-9  # computes this close to each other, relatively, are equal

Numbers = NDArray[np.float64]


def front_at(compute: ArrayLike, auc: ArrayLike, grid: ArrayLike) -> Numbers:
    """The front's AUC at G computes.

    Args:
        compute: (..., P) of the points.
        auc: (..., P) of the points.
        grid: (G,).

    Returns:
        (..., G); nan below the cheapest point, and everywhere if there is none.
    """
    cost, gain = np.asarray(compute, np.float64), np.asarray(auc, np.float64)
    limits = np.asarray(grid, np.float64) * (1.0 + ROUNDING)
    best = np.full((*cost.shape[:-1], limits.size), -np.inf)
    for point in range(cost.shape[-1]):  # one by one: all at once would take (..., G, P) numbers
        affordable = cost[..., point, None] <= limits
        best = np.where(affordable, np.maximum(best, gain[..., point, None]), best)
    return np.where(np.isneginf(best), np.nan, best)


def hypervolume(compute: ArrayLike, auc: ArrayLike, cheapest: float) -> Numbers:
    """Area between the front and `REFERENCE_AUC` over log compute, as a share of the greatest.

    It reaches from the compute ``cheapest``, that of always running the cheapest technique, to 1.
    A point that costs less counts as if it cost that; one that costs more than 1 for nothing. So 1
    is AUC 1 at the least compute, and 0 no AUC above the reference.

    Args:
        compute: (..., P) of the points.
        auc: (..., P) of the points.
        cheapest: in (0, 1); nan comes out where it is 1: a single technique leaves no choice.

    Returns:
        (...), in [0, 1].
    """
    cost, gain = np.asarray(compute, np.float64), np.asarray(auc, np.float64)
    if cheapest >= 1.0:
        return np.full(cost.shape[:-1], np.nan)
    logs = np.log(np.clip(cost, cheapest, 1.0))
    order = np.argsort(logs, axis=-1, kind="stable")
    rising = np.take_along_axis(logs, order, -1)
    best = np.maximum.accumulate(np.take_along_axis(gain, order, -1), axis=-1)
    ends = np.concatenate([rising[..., 1:], np.zeros((*rising.shape[:-1], 1))], axis=-1)
    area = ((ends - rising) * np.maximum(best - REFERENCE_AUC, 0.0)).sum(axis=-1)
    return np.asarray(area / (-np.log(cheapest) * (1.0 - REFERENCE_AUC)))
