"""Estimated correctness p̂: a calibrated function of statistic and margin.

The coefficients were fitted on simulated routes only, by ``scripts/calibrate.py``, and are read
from ``calibration.json``. The compiled twins of :func:`design`, :func:`belief_design`,
:func:`map_design` and the logistic function are ``estimate_correctness`` of SIC and of the belief;
tests hold them equal.
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
    table: dict[str, Any] = json.loads(
        files("amusic_gym.estimation").joinpath(FILE).read_text("utf-8")
    )
    return table


UNCALIBRATED = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 30.0, 0.0])
"""Coefficients with which the belief is taken at its word: p̂ is the belief itself."""


def coefficients(statistic: str) -> NDArray[np.float64]:
    """Coefficients of the calibration for a statistic: (13,) for SIC's, (7,) for the belief.

    ``mean`` and ``evidence``: p̂ = σ(b₀ + b₁s + b₂t + b₃h + b₄u + b₅m) · σ(b₆ + b₇r) where the fused
    winner has a rival beyond the tolerance, and σ(b₈ + b₉s + b₁₀t) · σ(b₁₁ + b₁₂r) where it has
    none; σ is the logistic function. ``belief``: p̂ = σ(b₀ + b₁o + b₂m + b₃l + b₄a) · σ(b₅ + b₆r).

    The first factor is that the place is right on the map. Of SIC: s = asinh(statistic),
    discounted, m = asinh(margin), t = log(1 + frames in a row on which the prediction moved on by
    one place); h ∈ [0, 1] is how much another technique has a say, u how much one says the same
    (``weigh_others`` in :mod:`amusic_gym.estimation.sic.update`). Of the belief: o is the log-odds
    of what it holds within the tolerance of the prediction, m the logarithm of its ratio to what it
    holds around the best rival, l the log-likelihood that the frame's rows gave the prediction
    together, and a the running mean over the frames of what each row gave it.

    The second is that the robot is on the map at all: r is the log-odds of that
    (``update_on_map`` in :mod:`amusic_gym.estimation.prediction`). It falls within a few frames
    where nothing looks as it usually does, however long a good drive lies behind.
    """
    entry = stored()["coefficients"][statistic]
    return np.array([number for part in entry.values() for number in part], np.float64)


def design(
    statistic: ArrayLike, track: ArrayLike, rivals: tuple[ArrayLike, ArrayLike, ArrayLike] | None
) -> NDArray[np.float64]:
    """Inputs of the first factor: (n, 6) where there are rivals, (n, 3) where there are none.

    Args:
        statistic: (n,) of the fused winner, discounted.
        track: (n,) frames in a row on which the prediction moved on by one place.
        rivals: how much others have a say, and say the same, in [0, 1], and the margin, each (n,).
    """
    s, t = np.arcsinh(np.asarray(statistic, np.float64)), np.log1p(np.asarray(track, np.float64))
    columns = [np.ones_like(s), s, t]
    if rivals is not None:
        heard, support, margin = (np.asarray(given, np.float64) for given in rivals)
        columns += [heard, support, np.arcsinh(margin)]
    return np.stack(columns, axis=-1)


def map_design(log_odds: ArrayLike) -> NDArray[np.float64]:
    """Inputs (n, 2) of the second factor, of log-odds (n,) of being on the map."""
    r = np.asarray(log_odds, np.float64)
    return np.stack([np.ones_like(r), r], axis=-1)


def belief_design(
    log_odds: ArrayLike,
    log_ratio: ArrayLike,
    log_likelihood: ArrayLike,
    log_likelihood_mean: ArrayLike,
) -> NDArray[np.float64]:
    """Inputs (n, 5) of the belief's first factor; all are logarithms already."""
    columns = log_odds, log_ratio, log_likelihood, log_likelihood_mean
    return np.stack([np.ones(np.shape(log_odds)), *columns], axis=-1)


def logistic(logit: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 / (1 + exp(−logit))."""
    return 1.0 / (1.0 + np.exp(-np.clip(logit, -30.0, 30.0)))


def fit_product(
    first: NDArray[np.float64], second: NDArray[np.float64], correct: ArrayLike
) -> NDArray[np.float64]:
    """Maximum-likelihood coefficients (d + e,) of a product of two logistic functions.

    Args:
        first: (n, d) inputs of one.
        second: (n, e) inputs of the other.
        correct: (n,) bool.

    Raises:
        ValueError: as :func:`fit`.
    """
    from scipy.optimize import minimize  # of use to whoever calibrates only

    target = np.asarray(correct, np.float64)
    split = first.shape[1]

    def loss(b: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        one, other = logistic(first @ b[:split]), logistic(second @ b[split:])
        p = np.clip(one * other, 1e-12, 1.0 - 1e-12)
        likelihood = target * np.log(p) + (1.0 - target) * np.log1p(-p)
        slope = (p - target) / (1.0 - p) / target.size
        gradient = [first.T @ (slope * (1.0 - one)), second.T @ (slope * (1.0 - other))]
        ridge = 1e-4 * float(b[split:] @ b[split:])  # keeps the second factor from standing still
        gradient[1] += 2e-4 * b[split:]
        return ridge - float(likelihood.mean()), np.concatenate(gradient)

    start = np.concatenate([fit(first, correct), np.ones(second.shape[1])])
    found: NDArray[np.float64] = minimize(loss, start, jac=True, method="L-BFGS-B").x
    return found


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
