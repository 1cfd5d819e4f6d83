"""Policies that are not learned: the paper's rule, fixed subsets, simple rules and bounds.

Adding one: a file with its class, one line in ``POLICIES``, one test.
"""

from __future__ import annotations

from collections.abc import Callable

from amusic_baselines.amusic import amusic
from amusic_baselines.borda import borda
from amusic_baselines.cascade import cascade
from amusic_baselines.dynmpf import dynmpf
from amusic_baselines.hmm import hmm
from amusic_baselines.hmpf import hmpf
from amusic_baselines.mpf import mpf
from amusic_baselines.oracle import oracle
from amusic_baselines.periodic import periodic
from amusic_baselines.plurality import plurality
from amusic_baselines.raw import raw
from amusic_baselines.subset import music, single, subset
from amusic_baselines.switchhit import switchhit
from amusic_baselines.uniform import uniform
from amusic_baselines.voi import voi
from amusic_gym.policies.protocol import Context, Policy
from amusic_gym.utils.names import suggest

Factory = Callable[[str | None, Context], Policy]

POLICIES: dict[str, Factory] = {
    "raw": raw,
    "single": single,
    "subset": subset,
    "music": music,
    "amusic": amusic,
    "random": uniform,
    "periodic": periodic,
    "cascade": cascade,
    "voi": voi,
    "oracle": oracle,
    "mpf": mpf,
    "hmpf": hmpf,
    "dynmpf": dynmpf,
    "switchhit": switchhit,
    "plurality": plurality,
    "borda": borda,
    "hmm": hmm,
}

NEEDS_GROUND_TRUTH = {
    "oracle": "of the route itself",
    "switchhit": "of routes to learn from",
}
"""Policies that a robot could not run without labelled frames -> which labels they need."""


READS_COMPUTE_WEIGHT = ("voi", "voi:idle")
"""Policies that weigh compute with the λ of their environment: comparisons run them once per λ."""


def label(spec: str) -> str:
    """How to show a policy where policies are compared: marked if it needs ground truth."""
    needed = NEEDS_GROUND_TRUTH.get(spec.partition(":")[0])
    return f"{spec} (needs ground truth {needed})" if needed else spec


def make_policy(spec: str, context: Context) -> Policy:
    """Build the policy of a ``NAME`` or ``NAME:ARGUMENT``.

    Raises:
        ValueError: for an unknown name or a wrong argument, with the valid ones.
    """
    name, colon, argument = spec.partition(":")
    if name not in POLICIES:
        raise ValueError(suggest("policy", name, POLICIES))
    return POLICIES[name](argument if colon else None, context)


__all__ = ["NEEDS_GROUND_TRUTH", "POLICIES", "READS_COMPUTE_WEIGHT", "label", "make_policy"]
