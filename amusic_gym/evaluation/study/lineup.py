"""The entrants of a study: policies by their names, and groups of trained selectors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from amusic_gym.estimation.settings import STATISTICS
from amusic_gym.evaluation.contestants import Contestant, all_subsets, contestants
from amusic_gym.evaluation.study.plan import Entrant
from amusic_gym.policies.registry import LEARNED, MAY_IDLE, VARIANT, parse
from amusic_gym.utils.names import suggest


@dataclass(frozen=True)
class Lineup:
    """What the command line asks for."""

    policies: tuple[str, ...]  # specs, with ``@STATISTIC`` for one under another statistic
    selectors: dict[str, tuple[str, ...]]  # name → specs of its trained runs, one per seed
    all_subsets: bool  # whether all fixed subsets are added
    # what the user insists on: ``statistic``, ``carry``, ``discount``; None: nothing
    insisted: dict[str, Any]
    compute_weights: tuple[float, ...]  # λ of the learned selectors

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
        parsed = parse(plain)
        made = self._contestant(plain, statistic)
        family = MAY_IDLE if parsed.idles else parsed.policy.family
        return Entrant(
            name=spec,
            family=VARIANT if statistic else family,
            contestants=(made,),
            statistic=statistic,
            draws=parsed.policy.draws,
            needs_truth=made.needs_truth,
        )

    def _selector(self, name: str, runs: Sequence[str]) -> Entrant:
        made = tuple(self._contestant(run) for run in runs)
        needed = max(each.needs_truth for each in made)  # if any run does
        return Entrant(name=name, family=LEARNED, contestants=made, needs_truth=needed)

    def _contestant(self, spec: str, statistic: str | None = None) -> Contestant:
        insisted = {**self.insisted, **({"statistic": statistic} if statistic else {})}
        (made,) = contestants([spec], compute_weights=self.compute_weights, **insisted)
        return made


def split_statistic(spec: str) -> tuple[str, str | None]:
    """``POLICY@STATISTIC`` in its two parts; a folder's name may hold an @.

    ``ppo@STATISTIC`` is the name of a selector that ships, and no variant of another.

    Raises:
        ValueError: for an unknown statistic.
    """
    policy = parse(spec).policy
    plain, at, statistic = spec.rpartition("@")
    if policy.name.endswith("@"):
        return spec, None
    if at and statistic in STATISTICS:
        return plain, statistic
    if at and policy.family != LEARNED:
        raise ValueError(f"{spec}: {suggest('statistic', statistic, STATISTICS)}")
    return spec, None
