"""Checks of arguments that several parts share; each refuses with name, value and mend."""

from __future__ import annotations

import math
import numbers
from typing import Any


def whole(name: str, value: Any, least: int, otherwise: str = "") -> int:
    """A whole number, Python's or NumPy's; ``otherwise`` says what else may be given.

    Raises:
        ValueError: for anything else, or one below ``least``.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
        raise ValueError(f"{name} is {value!r}; give a whole number >= {least}{otherwise}")
    return int(value)


def number(name: str, value: Any, wanted: str) -> float:
    """A finite number; ``wanted`` says what to give instead.

    Raises:
        ValueError: for anything else.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}; give {wanted}")
    return float(value)


def flag(name: str, value: Any) -> bool:
    """True or False.

    Raises:
        ValueError: for anything else: a text like "no" would count as true.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {value!r}; give True or False")
    return value
