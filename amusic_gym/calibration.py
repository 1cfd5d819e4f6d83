"""Estimated correctness p̂: a calibrated function of statistic and margin.

The coefficients were fitted on simulated routes only, by ``scripts/calibrate.py``, and are read
from ``calibration.json``. The compiled twins of :func:`design`, :func:`belief_design` and the
logistic function are ``estimate`` and ``believe`` in :mod:`amusic_gym.dynamics`; tests hold them
equal.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FILE = "calibration.json"


@cache
def stored() -> dict[str, Any]:
    """What ``scripts/calibrate.py`` wrote: coefficients per statistic and how they were made."""
    table: dict[str, Any] = json.loads(files("amusic_gym").joinpath(FILE).read_text("utf-8"))
    return table


UNCALIBRATED = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
"""Coefficients with which the belief is taken at its word: p̂ is the belief itself."""


def coefficients(statistic: str) -> NDArray[np.float64]:
    """Coefficients of the calibration for a statistic: (11,) for SIC's, (5,) for the belief.

    ``mean`` and ``evidence``: logit p̂ = b₀ + b₁s + b₂t + b₃r + b₄h + b₅u + b₆m where the fused
    winner has a margin over a rival beyond the tolerance, and b₇ + b₈s + b₉t + b₁₀r where it has
    none. Here s = asinh(statistic), discounted, m = asinh(margin), and t = log(1 + frames in a row
    on which the prediction moved on by one place). r = asinh of the running mean, over the runs of
    the technique trusted, of the z-score of the prediction in its rows: the statistic remembers
    the whole drive, r what rows say of late, for instance that the robot has left the map.
    h ∈ [0, 1] is how much another technique has a say, u how much one says the same
    (``weigh_others`` in :mod:`amusic_gym.dynamics`).

    ``belief``: logit p̂ = b₀ + b₁s + b₂m + b₃l + b₄a. Here s is the log-odds of the belief within
    the tolerance of the prediction, m the logarithm of its ratio to the belief around the best
    rival, l the log-likelihood that the frame's rows gave the prediction together, and a the
    running mean over the frames of what each row gave it.
    """
    entry = stored()["coefficients"][statistic]
    return np.array([number for part in entry.values() for number in part], np.float64)


def design(
    statistic: ArrayLike,
    track: ArrayLike,
    recent: ArrayLike,
    rivals: tuple[ArrayLike, ArrayLike, ArrayLike] | None,
) -> NDArray[np.float64]:
    """Inputs of SIC's logit: (n, 7) where there are rivals, (n, 4) where there are none.

    Args:
        statistic: (n,) of the fused winner, discounted.
        track: (n,) frames in a row on which the prediction moved on by one place.
        recent: (n,) running mean of the z-scores that the technique trusted gave the predictions.
        rivals: how much others have a say, and say the same, in [0, 1], and the margin, each (n,).
    """
    s, t = np.arcsinh(np.asarray(statistic, np.float64)), np.log1p(np.asarray(track, np.float64))
    columns = [np.ones_like(s), s, t, np.arcsinh(np.asarray(recent, np.float64))]
    if rivals is not None:
        heard, support, margin = (np.asarray(given, np.float64) for given in rivals)
        columns += [heard, support, np.arcsinh(margin)]
    return np.stack(columns, axis=-1)


def belief_design(
    log_odds: ArrayLike, log_ratio: ArrayLike, said: ArrayLike, said_mean: ArrayLike
) -> NDArray[np.float64]:
    """Inputs (n, 5) of the belief's logit; all are logarithms already."""
    columns = [np.asarray(given, np.float64) for given in (log_odds, log_ratio, said, said_mean)]
    return np.stack([np.ones_like(columns[0]), *columns], axis=-1)


def logistic(logit: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 / (1 + exp(−logit))."""
    return 1.0 / (1.0 + np.exp(-np.clip(logit, -30.0, 30.0)))


def fit(inputs: NDArray[np.float64], correct: ArrayLike) -> NDArray[np.float64]:
    """Maximum-likelihood coefficients of a logistic regression, by Newton's method.

    Args:
        inputs: (n, d) from :func:`design`.
        correct: (n,) bool.

    Raises:
        ValueError: if all matches are right or all wrong: nothing can be calibrated on them.
    """
    target = np.asarray(correct, np.float64)
    if target.min() == target.max():
        raise ValueError("calibration needs right and wrong matches; simulate more routes")
    weights = np.zeros(inputs.shape[1])
    ridge = 1e-6 * np.eye(inputs.shape[1])  # keeps separable samples finite
    for _ in range(100):
        p = logistic(inputs @ weights)
        gradient = inputs.T @ (p - target) / target.size + ridge @ weights
        hessian = (inputs * (p * (1.0 - p))[:, None]).T @ inputs / target.size + ridge
        step = np.linalg.solve(hessian, gradient)
        weights -= step
        if np.abs(step).max() < 1e-10:
            break
    return weights
