"""Ranges of the simulator: drawing from them, and refusing bad ones in a sentence."""

from __future__ import annotations

import math
import operator

import numpy as np

Range = tuple[float, float]


def draw(rng: np.random.Generator, limits: Range) -> float:
    """Uniform within the limits."""
    return float(rng.uniform(*limits))


def draw_integer(rng: np.random.Generator, limits: tuple[int, int]) -> int:
    """Uniform integer, both ends included."""
    return int(rng.integers(limits[0], limits[1] + 1))


def check_number(name: str, value: float, least: float, most: float) -> None:
    """Refuse what is no number from `least` to `most`."""
    if not isinstance(value, (int, float, np.number)) or not least <= value <= most:
        raise ValueError(f"{name} is {value!r}; give a number from {least:g} to {most:g}.")


def check_range(name: str, value: Range, least: float, most: float, integers: bool) -> None:
    """Refuse what is no rising pair from `least` to `most`."""
    kind = "integers" if integers else "numbers"
    wanted = f"give two {kind} (low, high) with {least:g} <= low <= high <= {most:g}"
    if not isinstance(value, tuple) or len(value) != 2:
        raise ValueError(f"{name} is {value!r}; {wanted}.")
    for end in value:
        if integers and not _is_integer(end):
            raise ValueError(f"{name} is {value!r}; {wanted}.")
        if not isinstance(end, (int, float, np.number)) or not math.isfinite(end):
            raise ValueError(f"{name} is {value!r}; {wanted}.")
    if not least <= value[0] <= value[1] <= most:
        raise ValueError(f"{name} is {value!r}; {wanted}.")


def _is_integer(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def check_integer(name: str, value: int, least: int, most: float = math.inf) -> int:
    """The value as int; refused unless an integer from `least` to `most`."""
    if not _is_integer(value) or not least <= value <= most:
        bounds = f"of at least {least}" if most == math.inf else f"from {least} to {most:g}"
        raise ValueError(f"{name} is {value!r}; give an integer {bounds}.")
    return operator.index(value)
