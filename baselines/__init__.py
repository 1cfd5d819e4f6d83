"""Policies that are not learned: the paper's rule, fixed subsets, simple rules and bounds.

Adding one: a file with its class, one line in ``POLICIES``, one test.
"""

from __future__ import annotations

from collections.abc import Callable

from amusic_gym.names import suggest
from amusic_gym.policy import Context, Policy
from baselines.amusic import amusic
from baselines.cascade import cascade
from baselines.oracle import oracle
from baselines.raw import raw
from baselines.subset import music, single, subset
from baselines.uniform import uniform

Factory = Callable[[str | None, Context], Policy]

POLICIES: dict[str, Factory] = {
    "raw": raw,
    "single": single,
    "subset": subset,
    "music": music,
    "amusic": amusic,
    "random": uniform,
    "cascade": cascade,
    "oracle": oracle,
}


def make_policy(spec: str, context: Context) -> Policy:
    """Build the policy of a ``NAME`` or ``NAME:ARGUMENT``.

    Raises:
        ValueError: for an unknown name or a wrong argument, with the valid ones.
    """
    name, colon, argument = spec.partition(":")
    if name not in POLICIES:
        raise ValueError(suggest("policy", name, POLICIES))
    return POLICIES[name](argument if colon else None, context)


__all__ = ["POLICIES", "make_policy"]
