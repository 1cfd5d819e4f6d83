"""Ranges of the simulator: drawing from them, and refusing bad ones in a sentence."""

from typing import Any

import numpy as np

Range = tuple[float, float]

_REAL = (int, float, np.number)


def draw(rng: np.random.Generator, limits: Range) -> float:
    """Uniform within the limits."""
    return float(rng.uniform(*limits))


def draw_integer(rng: np.random.Generator, limits: tuple[int, int]) -> int:
    """Uniform integer, both ends included."""
    return int(rng.integers(limits[0], limits[1] + 1))


def check_limits(name: str, value: Any, default: Any, least: float, most: float) -> None:
    """Refuse what is not of the default's kind: a number or a rising pair, within limits."""
    if not isinstance(default, tuple):
        if not isinstance(value, _REAL) or not least <= value <= most:
            raise ValueError(f"{name} is {value!r}; give a number from {least:g} to {most:g}.")
        return
    integers = isinstance(default[0], int)
    kind = (int, np.integer) if integers else _REAL
    good = isinstance(value, tuple) and len(value) == 2
    good = good and all(isinstance(end, kind) and not isinstance(end, bool) for end in value)
    if not good or not least <= value[0] <= value[1] <= most or value[1] == float("inf"):
        what = "integers" if integers else "numbers"
        raise ValueError(
            f"{name} is {value!r}; give two {what} (low, high) with {least:g} <= low <= high <= "
            f"{most:g}."
        )
