"""SIC-estimated correctness p̂: a calibrated function of statistic and margin.

The coefficients were fitted on simulated routes only, by ``scripts/calibrate.py``.
"""

from __future__ import annotations

import json
import math
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

COEFFICIENTS = 6
"""Bias, statistic, margin and product where there is a rival; bias and statistic without one."""


@cache
def _stored() -> dict[str, list[float]]:
    text = files("amusic_gym").joinpath("calibration.json").read_text(encoding="utf-8")
    table: dict[str, list[float]] = json.loads(text)["coefficients"]
    return table


def coefficients(statistic: str) -> NDArray[np.float64]:
    """Coefficients (6,) of the calibration for a statistic.

    With s = asinh(statistic) and m = asinh(margin): logit p̂ = b₀ + b₁s + b₂m + b₃sm where the
    winner has a rival, and b₄ + b₅s where it has none.
    """
    return np.array(_stored()[statistic])


def features(statistic: float, margin: float, has_rival: bool) -> NDArray[np.float64]:
    """The six inputs of the logit, in the order of :func:`coefficients`."""
    s, m = math.asinh(statistic), math.asinh(margin)
    return np.array([1.0, s, m, s * m, 0.0, 0.0] if has_rival else [0.0, 0.0, 0.0, 0.0, 1.0, s])
