"""The policies of a comparison, by their names."""

import inspect
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations
from pathlib import Path
from typing import Any

from amusic_gym.evaluation.store import code_digest
from amusic_gym.policies.protocol import Context, Policy
from amusic_gym.policies.registry import parse

COMPUTE_WEIGHTS = (0.01, 0.05, 0.15, 0.3, 0.6, 1.0, 2.0, 6.0)
"""The compute weights λ that a policy which reads λ is run with where none are named."""

MOST_TECHNIQUES = 6  # up to so many techniques all their subsets can be compared: 63 of them


@dataclass(frozen=True)
class Contestant:
    """A policy in a comparison."""

    name: str  # of the policy in tables and files
    make: Callable[[Context], Policy]  # builds it, afresh for every row
    # the λ that it is run with, one row each; None: it has no such thing
    compute_weights: tuple[float | None, ...] = (None,)
    # what its behaviour depends on besides its name: a digest of its weights or code
    version: str = ""
    needs_truth: str = ""  # of what it needs ground truth, if it does; tables say so


def contestants(
    specs: Sequence[str],
    *,
    statistic: str | None = None,
    carry: bool | None = None,
    discount: bool | None = None,
    compute_weights: Sequence[float] = COMPUTE_WEIGHTS,
) -> list[Contestant]:
    """The registered policies of ``NAME:ARGUMENT`` specs, each once.

    Args:
        specs: as on the command line of compare.
        statistic: the one that the user insists on; a trained selector refuses another.
        carry: as `statistic`, whether places are carried on as candidates.
        discount: as `statistic`, whether MuSIC discounts alike rows.
        compute_weights: λ of the policies that read it.

    Raises:
        FileNotFoundError: for a run folder that is not there.
        ValueError: for a folder that is no run's, or a statistic that no selector ships for.
    """
    insisted = {"statistic": statistic, "carry": carry, "discount": discount}
    chosen = {name: value for name, value in insisted.items() if value is not None}
    return [_contestant(spec, chosen, tuple(compute_weights)) for spec in dict.fromkeys(specs)]


def _contestant(spec: str, chosen: Mapping[str, Any], weights: tuple[float, ...]) -> Contestant:
    policy, argument = parse(spec)
    facts = policy.facts(argument)
    return Contestant(
        spec,
        partial(_build, policy.build, argument, dict(chosen)),
        weights if policy.reads_weight(argument or "") else (None,),
        version=f"{facts.version} {_code_of(policy.build)}",
        needs_truth=facts.needs_truth or policy.needs_truth,
    )


def _build(
    build: Callable[[str | None, Context], Policy],
    argument: str | None,
    chosen: dict[str, Any],
    context: Context,
) -> Policy:
    """Build a policy; a function that other processes can import."""
    return build(argument, replace(context, **chosen, insists="statistic" in chosen))


@cache
def _code_of(build: Callable[..., Any]) -> str:
    """Digest of the code behind a policy; empty for what was typed at a prompt."""
    module = sys.modules[build.__module__]
    file = Path(getattr(module, "__file__", None) or "")
    if not (inspect.isfunction(build) and file.is_file()):
        return ""
    top = sys.modules[build.__module__.partition(".")[0]]
    return code_digest(file, Path(str(top.__file__)).parent)


def all_subsets(techniques: Sequence[str]) -> list[str]:
    """Every subset as ``single:A``, ``subset:A+B`` or ``music``; a ValueError for too many."""
    if len(techniques) > MOST_TECHNIQUES:
        raise ValueError(
            f"{len(techniques)} techniques have {2 ** len(techniques) - 1} subsets, too many to "
            f"compare (all of up to {MOST_TECHNIQUES} techniques are); name some as subset:A+B"
        )
    parts = [f"single:{name}" for name in techniques]
    for size in range(2, len(techniques)):
        parts += [f"subset:{'+'.join(names)}" for names in combinations(techniques, size)]
    return parts + (["music"] if len(techniques) > 1 else [])


def check_weights(weights: Sequence[float]) -> tuple[float, ...]:
    """Compute weights without repetition, refused where one is not a number >= 0."""
    for weight in weights:
        if not (math.isfinite(weight) and weight >= 0):
            raise ValueError(f"compute weight is {weight}; give numbers >= 0")
    return tuple(dict.fromkeys(float(weight) for weight in weights))
