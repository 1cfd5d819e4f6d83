"""The entrants of a study: policies as compare.py takes them, and groups of trained selectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

from amusic_gym.cli.contestants import contestants
from amusic_gym.estimation.settings import STATISTICS
from amusic_gym.evaluation.comparison import Contestant, all_subsets
from amusic_gym.evaluation.plots.labels import is_idle
from amusic_gym.evaluation.study import Entrant
from amusic_gym.evaluation.study import cells as kinds
from amusic_gym.policies.protocol import Context, Policy
from amusic_gym.utils.names import suggest

FAMILIES = {
    "single": kinds.FIXED,
    "subset": kinds.FIXED,
    "music": kinds.FIXED,
    "cascade": kinds.CASCADE,
    "amusic": kinds.AMUSIC,
    "periodic": kinds.PERIODIC,
    "voi": kinds.VOI,
    "random": kinds.RANDOM,
    "oracle": kinds.BOUND,
}
"""Kind of a policy → its family, unless it may idle; others are learned if they have λ, and else
peers."""

DRAWING = ("random",)
"""Policies that draw."""


Insisted = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Lineup:
    """What the command line asks for.

    Attributes:
        policies: specs, with ``@STATISTIC`` for one under another statistic.
        selectors: name → specs of its trained runs, one per seed.
        all_subsets: whether all fixed subsets are added.
        insisted: what the user insists on: ``statistic``, ``carry``, ``discount``; None: nothing.
        compute_weights: λ of the learned selectors.
    """

    policies: tuple[str, ...]
    selectors: dict[str, tuple[str, ...]]
    all_subsets: bool
    insisted: dict[str, Any]
    compute_weights: tuple[float, ...]

    def entrants(self, techniques: Sequence[str]) -> list[Entrant]:
        """All entrants for a bank with these techniques.

        Raises:
            FileNotFoundError: for a run folder that is not there.
            ValueError: for an unknown statistic, or a spec without a run.
        """
        subsets = all_subsets(techniques) if self.all_subsets else []
        specs = list(dict.fromkeys([*subsets, *self.policies]))
        return [
            *(self._policy(spec) for spec in specs),
            *(self._selector(name, runs) for name, runs in self.selectors.items()),
        ]

    def _policy(self, spec: str) -> Entrant:
        plain, statistic = split_statistic(spec)
        kind = plain.partition(":")[0]
        made = self._contestant(plain, statistic)
        other = kinds.PEER if made.compute_weights == (None,) else kinds.LEARNED
        family = kinds.IDLE if is_idle(plain) else FAMILIES.get(kind, other)
        return Entrant(
            name=spec,
            family=kinds.VARIANT if statistic else family,
            contestants=(made,),
            statistic=statistic,
            draws=kind in DRAWING,
            needs_truth=made.needs_truth,
        )

    def _selector(self, name: str, runs: Sequence[str]) -> Entrant:
        made = tuple(self._contestant(run) for run in runs)
        needed = max(each.needs_truth for each in made)  # if any run does
        return Entrant(name=name, family=kinds.LEARNED, contestants=made, needs_truth=needed)

    def _contestant(self, spec: str, statistic: str | None = None) -> Contestant:
        insisted = {**self.insisted, **({"statistic": statistic} if statistic else {})}
        (made,) = contestants([spec], compute_weights=self.compute_weights, **insisted)
        return replace(made, make=partial(build, spec, tuple(insisted.items())))


def split_statistic(spec: str) -> tuple[str, str | None]:
    """``POLICY@STATISTIC`` in its two parts; a folder's name may hold an @.

    ``ppo@STATISTIC`` is the name of a selector that ships, and no variant of another.

    Raises:
        ValueError: for an unknown statistic.
    """
    plain, at, statistic = spec.rpartition("@")
    if plain == "ppo":
        return spec, None
    if at and statistic in STATISTICS:
        return plain, statistic
    if at and not spec.startswith("ppo:"):
        raise ValueError(f"{spec}: {suggest('statistic', statistic, STATISTICS)}")
    return spec, None


def build(spec: str, insisted: Insisted, context: Context) -> Policy:
    """Build a policy; a function that workers can import."""
    return _made(spec, insisted).make(context)


@cache
def _made(spec: str, insisted: Insisted) -> Contestant:
    (made,) = contestants([spec], **dict(insisted))
    return made
