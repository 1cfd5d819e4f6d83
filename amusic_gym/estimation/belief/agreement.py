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
from amusic_gym.estimation.belief.rows import dot, single, total
from amusic_gym.kernels.compiling import apart, inner
from amusic_gym.kernels.tables import part


@inner
def dot_away(
    one: NDArray[np.float32], other: NDArray[np.float32], size: int, low: int, high: int
) -> float:
    """Sum of the products of two rows (R,) over the places before ``low`` and from ``high`` on."""
    rest = size - high
    return dot(one, other, low) + dot(part(one, high, rest), part(other, high, rest), rest)


@apart
def centre(logs: NDArray[np.float32], size: int, low: int, high: int) -> float:
    """Subtract from a row (R,) its mean over the places away; the deviation there.

    0 if it hardly varies, or the places are too few.
    """
    rest, count = size - high, size - high + low
    mean = (total(logs, low) + total(part(logs, high, rest), rest)) / max(count, 1)
    subtracted = single(mean)
    for c in range(size):
        logs[c] -= subtracted
    spread = dot_away(logs, logs, size, low, high)
    if count < 3 or spread <= 1e-9 * count * mean * mean:
        return 0.0
    return math.sqrt(spread)


@apart
def learn_likenesses(
    likenesses: NDArray[np.float64],
    logs: NDArray[np.float32],
    weights: NDArray[np.float64],
    spreads: NDArray[np.float64],
    size: int,
    place: int,
) -> None:
    """Update the correlations of the techniques that ran together.

    Args:
        likenesses: (2, S, S) running means, and the frames behind each; below the diagonal.
        logs: (S, R) log-likelihoods; their means are taken out.
        weights: (S,) above 0 for a technique that ran and had something to say.
        spreads: (S,) scratch.
        size: R.
        place: the likeliest before the frame.
    """
    away = min(AWAY, size // 10)
    low, high = max(place - away, 0), min(place + away + 1, size)
    for s in range(weights.size):
        if weights[s] > 0.0:
            spreads[s] = centre(logs[s], size, low, high)
            for other in range(s):
                if weights[other] > 0.0:
                    likenesses[1, s, other] += 1.0
                    step = max(LIKENESS_STEP, 1.0 / likenesses[1, s, other])
                    new, spread = 0.0, spreads[s] * spreads[other]
                    if spread > 0.0:
                        new = dot_away(logs[s], logs[other], size, low, high) / spread
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
