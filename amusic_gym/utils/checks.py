"""Checks of arguments that several parts share; each refuses, by a ValueError, with a mend."""

import math
import numbers


def whole(
    name: str, value: object, least: int, otherwise: str = "", most: int | None = None
) -> int:
    """A whole number, Python's or NumPy's; ``otherwise`` says what else may be given.

    Raises:
        ValueError: for anything else, or one below ``least`` or above ``most``.
    """
    good = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    number = int(value) if good else 0  # type: ignore[call-overload]
    if not good or number < least or (most is not None and number > most):
        range_ = f">= {least}" if most is None else f"from {least} to {most}"
        raise ValueError(f"{name} is {value!r}; give a whole number {range_}{otherwise}")
    return number


def number(name: str, value: object, wanted: str) -> float:
    """A finite number; refuses anything else, and says that ``wanted`` should be given."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}; give {wanted}")
    return float(value)


def share(name: str, value: object) -> float:
    """A number from 0 to 1; refuses anything else."""
    found = number(name, value, "a number in [0, 1]")
    if not 0.0 <= found <= 1.0:
        raise ValueError(f"{name} is {value!r}; give a number in [0, 1]")
    return found


def flag(name: str, value: object) -> bool:
    """True or False; refuses anything else: a text like "no" would count as true."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {value!r}; give True or False")
    return value
