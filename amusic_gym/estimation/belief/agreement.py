"""How much each technique that ran on a frame counts: less, the more others err like it.

Two techniques err alike as far as their log-likelihoods are correlated over the places away from
the one believed in. With C of these correlations the weights g ≥ 0 maximise Σ g − gᵀ C g / 2: for
one technique 1, for two independent ones 1 each, for a technique and its copy ½ each.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.belief.model import AWAY, LIKENESS, LIKENESS_STEP, SWEEPS
from amusic_gym.estimation.belief.rows import dot, total
from amusic_gym.kernels.compiling import apart, inner


@inner
def correlation_away(
    one: NDArray[np.float64], other: NDArray[np.float64], size: int, place: int
) -> float:
    """Correlation of two rows (R,) over the places away from ``place``; 0: too few."""
    away = min(AWAY, size // 10)
    a, b, aa, bb, ab = 0.0, 0.0, 0.0, 0.0, 0.0
    low, high = max(place - away, 0), min(place + away + 1, size)
    for c in range(low, high):  # taken off again, so that the sums over all run in four lanes
        a -= one[c]
        b -= other[c]
        aa -= one[c] * one[c]
        bb -= other[c] * other[c]
        ab -= one[c] * other[c]
    a, b, count = a + total(one, size), b + total(other, size), float(size - high + low)
    aa, bb, ab = aa + dot(one, one, size), bb + dot(other, other, size), ab + dot(one, other, size)
    spread = (aa * count - a * a) * (bb * count - b * b)
    if count < 3.0 or spread <= 1e-9 * (aa * bb) * count * count:
        return 0.0
    return (ab * count - a * b) / math.sqrt(spread)


@apart
def learn_likenesses(
    likenesses: NDArray[np.float64],
    logs: NDArray[np.float64],
    weights: NDArray[np.float64],
    size: int,
    place: int,
) -> None:
    """Update the correlations of the techniques that ran together.

    Args:
        likenesses: (2, S, S) running means, and the frames behind each; below the diagonal.
        logs: (S, R) log-likelihoods.
        weights: (S,) above 0 for a technique that ran and had something to say.
        size: R.
        place: the likeliest before the frame.
    """
    for s in range(weights.size):
        for other in range(s):
            if weights[s] > 0.0 and weights[other] > 0.0:
                likenesses[1, s, other] += 1.0
                step = max(LIKENESS_STEP, 1.0 / likenesses[1, s, other])
                new = correlation_away(logs[s], logs[other], size, place)
                likenesses[0, s, other] += step * (new - likenesses[0, s, other])


@apart
def weigh_techniques(
    likenesses: NDArray[np.float64], weights: NDArray[np.float64], sums: NDArray[np.float64]
) -> None:
    """Find the weights (S,) in place; those that are 0 stay so.

    By multiplicative updates (Sha, Saul and Lee, 2002), which keep copies alike: g / C g.
    """
    for _ in range(SWEEPS):
        for s in range(weights.size):
            sums[s] = weights[s]
            for other in range(weights.size):
                if other != s:
                    measured = likenesses[0, max(s, other), min(s, other)]
                    alike = LIKENESS + (1.0 - LIKENESS) * max(measured, 0.0)
                    sums[s] += alike * weights[other]
        for s in range(weights.size):
            if weights[s] > 0.0:
                weights[s] /= sums[s]
