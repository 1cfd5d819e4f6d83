"""Checks that the policies' ``NAME:ARGUMENT`` share."""

from __future__ import annotations


def required(policy: str, argument: str | None, form: str) -> str:
    """The argument of a policy that needs one.

    Raises:
        ValueError: if there is none.
    """
    if not argument:
        raise ValueError(f"policy {policy!r} needs an argument; write {policy}:{form}")
    return argument


def none(policy: str, argument: str | None) -> None:
    """Refuse the argument of a policy that takes none.

    Raises:
        ValueError: if there is one.
    """
    if argument is not None:
        raise ValueError(f"policy {policy!r} takes no argument, got {argument!r}; write {policy}")
