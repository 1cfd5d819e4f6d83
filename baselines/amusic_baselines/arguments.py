"""Checks that the policies' ``NAME:ARGUMENT`` share; each refuses with a ValueError."""

import math

from amusic_gym.policies.protocol import Context


def required(policy: str, argument: str | None, form: str) -> str:
    """The argument of a policy that needs one."""
    if not argument:
        raise ValueError(f"policy {policy!r} needs an argument; write {policy}:{form}")
    return argument


def none(policy: str, argument: str | None) -> None:
    """Refuse the argument of a policy that takes none."""
    if argument is not None:
        raise ValueError(f"policy {policy!r} takes no argument, got {argument!r}; write {policy}")


def parts(policy: str, argument: str, form: str) -> list[str]:
    """The parts of an argument such as ``CHEAP/HOLD/THRESHOLD``, as many as ``form`` has."""
    found = argument.split("/")
    if len(found) != len(form.split("/")):
        raise ValueError(f"{policy}:{argument} is not of the form {policy}:{form}; write it so")
    return found


def columns(policy: str, argument: str, names: str, context: Context) -> list[int]:
    """Indices of the techniques of ``A+B``, a part of ``argument`` or all of it."""
    given = names.split("+")
    if len(set(given)) < len(given):
        raise ValueError(f"{policy}:{argument} names a technique twice; name each once")
    return [context.index(name) for name in given]


def technique_parts(
    policy: str, argument: str, form: str, context: Context
) -> tuple[list[int], list[str]]:
    """Indices of the techniques that lead an argument, all if none do, and its other parts."""
    names, _, rest = argument.partition("/")
    if len(argument.split("/")) <= len(form.split("/")):
        return list(range(len(context.techniques))), parts(policy, argument, form)
    found = parts(policy, rest, form)
    return columns(policy, argument, names, context), found


def whole(policy: str, argument: str, name: str, text: str, least: int, most: int) -> int:
    """A whole number out of ``argument``, called ``name`` in the sentence that refuses."""
    short = text.isascii() and text.isdigit() and len(text) < 20  # Python refuses endless numbers
    if not (short and least <= int(text) <= most):
        raise ValueError(
            f"{policy}:{argument}: {name} is {text!r}; give a whole number from {least} to {most}"
        )
    return int(text)


def number(
    policy: str, argument: str, name: str, text: str, least: float, most: float = math.inf
) -> float:
    """A finite number out of ``argument``, called ``name`` in the sentence that refuses."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and least <= value <= most):
        wanted = f"in [{least:g}, {most:g}]" if math.isfinite(most) else f">= {least:g}"
        raise ValueError(f"{policy}:{argument}: {name} is {text!r}; give a number {wanted}")
    return value
