"""Which cells a study has."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from amusic_gym import __version__
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation import store
from amusic_gym.evaluation.comparison import check_banks
from amusic_gym.evaluation.contestants import Contestant
from amusic_gym.evaluation.study import cells as measuring
from amusic_gym.evaluation.study.cells import CONDITIONS, LABELS, Bench, Cell
from amusic_gym.policies.protocol import Context, Correction
from amusic_gym.policies.registry import FAMILIES, FRONTS
from amusic_gym.routes.motion import RECORDED
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import distinct, suggest

MOST_WEIGHTS = 8  # λ of a learned selector's front: more would be a search for the best one

SEED_COUNT = 5

MEAN = "mean"  # in the place of a route's name: over all routes


@dataclass(frozen=True)
class Entrant:
    """A policy of a study, or several runs of one training, which are its seeds."""

    name: str  # in tables
    family: str  # of `FAMILIES`
    contestants: tuple[Contestant, ...]  # one, or one for each seed. What makes them must pickle
    statistic: str | None = None  # SIC's, if it is not the study's
    draws: bool = False  # whether the policy draws: then it has a cell per seed even as recorded
    needs_truth: str = ""  # of what it needs ground truth, if it does; tables say so


@dataclass(frozen=True)
class Plan:
    """All that a study has to do."""

    bench: Bench  # the recordings, for workers
    cells: tuple[Cell, ...]  # in the order of tables: routes, conditions, seeds, policies
    # of each recording ``bank`` (its name), ``queries``, ``references``, ``techniques``,
    # ``seconds`` and ``cheapest``, the least compute of a policy that always runs one
    routes: tuple[dict[str, Any], ...]
    # ``conditions``; ``seeds`` of motions, of policies that draw, and numbers of trainings;
    # ``statistic``, ``carry`` and ``discount`` of policies that do not bring their own;
    # ``costs``, the cost model; ``needs_truth``: name of an entrant → of what it needs
    # ground truth
    settings: dict[str, Any]


def make_plan(
    banks: Sequence[ScoreBank],
    entrants: Callable[[ScoreBank], Sequence[Entrant]],
    *,
    statistic: str = SICSettings.statistic,
    carry: bool | None = None,
    discount: bool | None = None,
    seeds: Sequence[int] = range(SEED_COUNT),
    conditions: Collection[str] = CONDITIONS,
) -> Plan:
    """The cells of every entrant on every bank.

    Every policy is built once for every bank, so that a wrong name is refused before anything
    runs. As recorded, an entrant has a cell per contestant and λ, and one per seed if it draws;
    in another motion, one per seed and λ: seed i goes with contestant i, if there are several.

    Args:
        banks: the routes, with the costs to reckon with. A name that several share is numbered.
        entrants: the policies for a bank.
        statistic: SIC's, for policies that do not bring their own.
        carry: whether places are carried on as candidates, likewise; None: as the statistic has it.
        discount: whether MuSIC discounts alike rows, likewise; None: as the statistic has it.
        seeds: different whole numbers >= 0.
        conditions: some of `CONDITIONS`.

    Raises:
        ValueError: for nothing to do, banks with different cost models, an entrant with a wrong
            number of contestants, more than `MOST_WEIGHTS` λ, or a policy that does not fit a
            bank or the statistic that it is asked for.
    """
    check_banks(banks)
    numbers = _check(seeds, conditions)
    conditions = tuple(dict.fromkeys(conditions))
    names = distinct([bank.name or "bank" for bank in banks], taken=(MEAN,))
    chosen = {"statistic": statistic, "carry": carry, "discount": discount}
    needs_truth: dict[str, str] = {}
    planned: list[Cell] = []
    for number, (bank, name) in enumerate(zip(banks, names, strict=True)):
        given = list(dict.fromkeys(entrants(bank)))
        _check_names([entrant.name for entrant in given])
        needs_truth |= {each.name: each.needs_truth for each in given if each.needs_truth}
        route = _Route(number, name, bank, numbers)
        jobs = [job for entrant in given for job in _jobs(route, entrant, chosen)]
        planned += [
            job.cell(condition, at)
            for condition in conditions
            for at in range(len(numbers))
            for job in jobs
            if at == 0 or job.varies(condition)
        ]
    if not planned:
        raise ValueError("no policy to study; give at least one")
    return Plan(
        bench=Bench(banks),
        cells=tuple(planned),
        routes=tuple(_described(*each) for each in zip(banks, names, strict=True)),
        settings={
            "conditions": list(conditions),
            "seeds": list(numbers),
            **chosen,
            "costs": banks[0].costs,
            "needs_truth": needs_truth,
        },
    )


def _check(seeds: Sequence[int], conditions: Collection[str]) -> tuple[int, ...]:
    numbers = tuple(whole("seed", seed, 0) for seed in seeds)
    if not numbers or len(set(numbers)) < len(numbers):
        raise ValueError(f"seeds are {list(numbers)}; give at least one, each once")
    if not conditions:
        raise ValueError(f"no condition; give some of {', '.join(CONDITIONS)}")
    for condition in conditions:
        if condition not in CONDITIONS:
            raise ValueError(suggest("condition", condition, CONDITIONS))
    return numbers


def _described(bank: ScoreBank, name: str) -> dict[str, Any]:
    return {
        "bank": name,
        "queries": bank.queries,
        "references": bank.references,
        "techniques": list(bank.techniques),
        "seconds": bank.seconds.tolist(),
        "cheapest": float(bank.seconds.min() / bank.seconds.sum()),
    }


@dataclass(frozen=True)
class _Route:
    """A bank of a study."""

    number: int
    name: str
    bank: ScoreBank
    seeds: tuple[int, ...]

    @cached_property
    def key(self) -> dict[str, Any]:
        """What may change the numbers of all cells on it."""
        return {
            "bank": store.bank_identity(self.bank),
            "costs": self.bank.costs,
            "code": store.code_digest(Path(measuring.__file__)),
            "version": __version__,
        }


@dataclass(frozen=True)
class _Job:
    """An entrant with one λ on a route."""

    route: _Route
    entrant: Entrant
    chosen: Mapping[str, Any]  # statistic, carry, discount, of a policy that does not bring its own
    own: Correction  # what it has in the end
    weight: float | None

    def varies(self, condition: str) -> bool:
        """Whether the seed makes a difference."""
        return condition != RECORDED or self.entrant.draws or len(self.entrant.contestants) > 1

    def cell(self, condition: str, at: int) -> Cell:
        """Its cell under a condition with the seed of that number."""
        route, entrant, seed = self.route, self.entrant, self.route.seeds[at]
        contestant = entrant.contestants[at % len(entrant.contestants)]
        retiming = None if condition == RECORDED else seed
        key = {
            **route.key,
            **self.own._asdict(),
            "condition": condition,
            "compute_weight": self.weight,
            "retiming": retiming,
            "policy": contestant.name,
            "policy_version": contestant.version,
            "drawing": seed if entrant.draws else None,
        }
        labels = {
            **key,
            "bank": route.name,
            "seed": seed if self.varies(condition) else None,
            "policy": entrant.name,
            "family": entrant.family,
            "member": contestant.name,
        }
        return Cell(
            path=store.stem_of(key),
            labels={label: labels[label] for label in LABELS},
            bank=route.number,
            make=contestant.make,
            chosen=self.chosen,
            retiming=retiming,
            seed=seed if entrant.draws else route.seeds[0],
            size=route.bank.queries,
        )


def _jobs(route: _Route, entrant: Entrant, chosen: Mapping[str, Any]) -> list[_Job]:
    """One per λ; builds every policy once to see that it can be built."""
    _check_entrant(entrant, len(route.seeds))
    chosen = {**chosen, **({"statistic": entrant.statistic} if entrant.statistic else {})}
    context = Context.of(route.bank, seed=route.seeds[0], **chosen)
    for contestant in entrant.contestants:
        own = Correction.under(contestant.make(context), **chosen)
        if entrant.statistic not in (None, own.statistic):
            raise ValueError(
                f"{entrant.name}: the policy has a statistic of its own, {own.statistic!r}, and"
                f" takes no other; leave out @{entrant.statistic}"
            )
    weights = dict.fromkeys(entrant.contestants[0].compute_weights)
    return [_Job(route, entrant, chosen, own, weight) for weight in weights]


def _check_names(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two policies are called {name!r}; give each a name of its own")


def _check_entrant(entrant: Entrant, seeds: int) -> None:
    if entrant.family not in FAMILIES:
        raise ValueError(suggest("family", entrant.family, FAMILIES))
    if entrant.family not in FRONTS and entrant.name in FRONTS.values():
        raise ValueError(f"{entrant.name!r} is what tables call a front; take another name")
    count = len(entrant.contestants)
    if count not in (1, seeds):
        raise ValueError(
            f"{entrant.name} has {count} runs for {seeds} seeds; give one run, or one for each seed"
        )
    for contestant in entrant.contestants:
        weights = contestant.compute_weights
        if not 0 < len(weights) <= MOST_WEIGHTS:
            raise ValueError(
                f"{entrant.name} has {len(weights)} compute weights; give 1 to {MOST_WEIGHTS}"
            )
