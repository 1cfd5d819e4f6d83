"""Simulated routes: score banks drawn from a model of descriptors, without any image.

Model, per technique. Every place of the map has a descriptor that changes smoothly along the
route (an Ornstein-Uhlenbeck process plus some grain of its own), parts of the map repeat earlier
parts (perceptual aliasing) and short spans are bland (hubs that attract queries, or voids that
repel them). A query descriptor is

    competence * place + sqrt(1 - competence ** 2) * noise + shift

where the noise is correlated in time, and competence and shift (a constant vector, which moves
whole rows and whole columns) belong to the condition the robot drives in: day, night, tunnel.
A score is the cosine of the two, bent and scaled so that techniques have ranges of their own.
`docs/simulation.md` compares the outcome with real recordings.
"""

import math
from dataclasses import dataclass, field, fields, replace
from math import inf
from string import ascii_uppercase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.routes.motion import (
    JUMP,
    KIDNAPPED,
    MOTIONS,
    PACED,
    RECORDED,
    SPEED_CHANGE,
    Motion,
    walk,
)
from amusic_gym.routes.ranges import Range, check_limits, draw, draw_integer
from amusic_gym.routes.retime import retime
from amusic_gym.routes.route_model import (
    Ints,
    RouteModel,
    bland_places,
    decoys,
    no_repeats,
    repeated_places,
)
from amusic_gym.routes.simulated_descriptors import TechniqueModel, smooth, write_scores
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import suggest

TECHNIQUE_NAMES = tuple(ascii_uppercase)  # so many techniques at most

MOST_FRAMES = 100_000


def _within(least: float, most: float, default: Any) -> Any:
    """A field of `Simulation`: a number, or the two ends of a range, from ``least`` to ``most``."""
    return field(default=default, metadata={"least": least, "most": most})


def _share(default: float) -> Any:
    return _within(0, 1, default)


@dataclass(frozen=True)
class Simulation:
    """Ranges from which routes are drawn; `(low, high)` is uniform and includes both ends.

    The defaults bracket what is measured on real recordings. Bad values are refused with
    ValueError when the object is made.
    """

    # The drive
    queries: tuple[int, int] = _within(1, MOST_FRAMES, (100, 400))  # frames
    references: int | None = None  # places in the map; None: see the next two
    map_factor: Range = _within(1, 1000, (1.0, 2.0))  # places per frame ...
    same_length: float = _share(0.5)  # ... but on this share of the routes as many as frames
    motion: Motion = "recorded"  # see routes.motion
    speed_change: float = _share(SPEED_CHANGE)  # paced, kidnapped: chance per frame of a draw
    jump: float = _share(JUMP)  # kidnapped: chance per frame of a jump to any place
    retimed: float = _share(0.0)  # share of the routes re-timed: half paced, half kidnapped
    tolerance: int = 2  # places off that still count as true
    wander: Range = _within(0, 1000, (0.0, 1.3))  # deviation of what images show ...
    wander_memory: Range = _within(0, inf, (3.0, 15.0))  # ... and the frames over which it changes

    # Who is good when
    techniques: tuple[int, int] = _within(1, len(TECHNIQUE_NAMES), (4, 4))
    conditions: tuple[int, int] = _within(1, 1000, (1, 5))  # different conditions on one route
    regime_length: Range = _within(1, inf, (40.0, 150.0))  # mean frames of a condition
    ability: Range = _within(0, 1, (0.3, 0.95))  # a technique's competence in ordinary conditions
    ability_spread: float = _share(0.15)  # standard deviation of competence between conditions
    useless: float = _share(0.2)  # chance that a technique is weak in a condition
    weak: Range = _within(0, 1, (0.0, 0.2))  # competence where it is weak
    strong: Range = _within(0, 1, (0.8, 0.97))  # competence where it must be good
    all_fail: float = _share(0.05)  # chance that a condition makes all techniques weak
    all_good: float = _share(0.1)  # chance that a condition makes all techniques strong
    exclusive: float = _share(0.15)  # share of routes with one good technique per condition
    seconds: Range = _within(1e-9, 1e9, (0.02, 2.0))  # cost of one run, log-uniform
    cost_follows_ability: float = _share(0.3)  # correlation of ranks: cost, mean competence
    copies: float = _share(0.0)  # chance that a technique sees what the one before it sees
    leaves: float = _share(0.0)  # share of routes that leave the map after a third or more

    # What a route looks like
    alias_density: float = _within(0, 100, 0.6)  # repeated segments per 100 places
    alias_length: tuple[int, int] = _within(1, 1_000_000, (8, 40))  # places
    bland_density: float = _within(0, 100, 1.0)  # hubs and voids per 100 places
    bland_length: tuple[int, int] = _within(1, 1_000_000, (1, 12))  # places
    hubs: float = _share(0.6)  # share of the bland spans that attract instead of repel
    decoy: float = _share(0.0)  # chance of a technique to see another place in a spell
    decoy_shared: float = _share(0.5)  # chance that others see the same wrong place
    decoy_strength: Range = _within(0, 1, (0.3, 0.9))  # share of its noise that looks like it

    # How techniques see it: ranges of `TechniqueModel`
    trend: Range = _within(0, 1, (0.0, 0.0))
    trend_length: Range = _within(0, inf, (40.0, 200.0))
    dimensions: tuple[int, int] = _within(2, 4096, (12, 48))
    smoothness: Range = _within(0, inf, (1.0, 14.0))
    grain: Range = _within(0, 1, (0.0, 0.4))
    aliasing: Range = _within(0, 1, (0.2, 0.95))
    bland: Range = _within(0, 100, (0.0, 1.5))
    base: Range = _within(0, 100, (0.3, 2.0))
    noise_memory: Range = _within(0, inf, (2.0, 20.0))
    noise_grain: Range = _within(0, 1, (0.0, 0.5))
    shift: Range = _within(0, 100, (0.5, 2.0))
    lasting: Range = _within(0, 1, (0.5, 1.0))
    bend: Range = _within(-1, 1, (-0.3, 0.45))
    offset: Range = _within(-1e6, 1e6, (0.1, 0.9))
    scale: Range = _within(1e-6, 1e6, (0.005, 0.07))

    def __post_init__(self) -> None:
        for each in fields(self):
            if each.metadata:
                check_limits(each.name, getattr(self, each.name), each.default, **each.metadata)
        whole("tolerance", self.tolerance, 0)
        if self.motion not in MOTIONS:
            raise ValueError(suggest("motion", self.motion, MOTIONS))
        if self.references is None:
            return
        whole("references", self.references, 1)
        if self.motion == RECORDED and self.references < self.queries[1]:
            raise ValueError(
                f"references is {self.references}, but the motion 'recorded' over "
                f"{self.queries[1]} queries needs at least as many places; raise it or use "
                "motion='paced'."
            )

    def route(self, rng: np.random.Generator, *, name: str = "simulated") -> ScoreBank:
        """Draw one route: a bank of (T, Q, R) scores that depends on `rng` alone."""
        queries = draw_integer(rng, self.queries)
        techniques = draw_integer(rng, self.techniques)
        same, factor = rng.random() < self.same_length, rng.uniform(*self.map_factor)
        references = self.references or (queries if same else round(queries * factor))
        competence, condition, spell = self._conditions(rng, techniques, queries)
        place = self._drive(rng, queries, references)
        decoy = lure = None
        if self.decoy:
            decoy, lure = decoys(
                rng,
                place,
                spell,
                references,
                techniques,
                chance=self.decoy,
                shared=self.decoy_shared,
                strength=self.decoy_strength,
            )
        leaves = None
        if self.leaves and rng.random() < self.leaves:
            leaves = int(rng.integers(queries // 3, queries))
        shared = RouteModel(
            place=place,
            seen=self._seen(rng, place, references),
            condition=condition,
            competence=competence,
            source=repeated_places(rng, references, self.alias_density, self.alias_length),
            bland=bland_places(rng, references, self.bland_density, self.bland_length, self.hubs),
            decoy=decoy,
            lure=lure,
            leaves=leaves,
        )
        seconds = self._seconds(rng, competence[:, condition].mean(axis=1))
        models = [self._technique_model(rng) for _ in range(techniques)]
        copied = np.zeros(techniques, np.bool_)
        if self.copies:
            copied[1:] = rng.random(techniques - 1) < self.copies
        bank = bank_of(rng, shared, models, seconds, self.tolerance, name, copied)
        if rng.random() < self.retimed:
            seed, motion = int(rng.integers(2**31)), PACED if rng.random() < 0.5 else KIDNAPPED
            bank = retime(bank, seed, motion)
        return bank

    def _drive(
        self, rng: np.random.Generator, queries: int, references: int
    ) -> NDArray[np.float64]:
        """(Q,) places from 0 to R - 1; unless as recorded, from the first half of the map on."""
        if self.motion == RECORDED:
            first = rng.integers(references - queries + 1)
            return first + np.arange(queries, dtype=np.float64)
        place = walk(
            rng,
            queries,
            references,
            jump=self.jump if self.motion == KIDNAPPED else 0.0,
            speed_change=self.speed_change,
            start=float(rng.integers(references)) / 2.0,
            between=True,
        )
        return np.minimum(place, references - 1.0)

    def _seen(
        self, rng: np.random.Generator, place: NDArray[np.float64], references: int
    ) -> NDArray[np.float64]:
        """(Q,) positions that the images look like: two drives never keep step."""
        off = smooth(rng, place.size, 1, draw(rng, self.wander_memory))[:, 0]
        return (place + draw(rng, self.wander) * off).clip(0.0, references - 1.0)

    def _conditions(
        self, rng: np.random.Generator, techniques: int, queries: int
    ) -> tuple[NDArray[np.float64], Ints, Ints]:
        """Competence (T, C) per technique and condition; condition and spell of each frame (Q,)."""
        count = draw_integer(rng, self.conditions)
        shape = (techniques, count)
        ability = rng.uniform(*self.ability, (techniques, 1))
        competence = np.clip(ability + self.ability_spread * rng.standard_normal(shape), 0.0, 0.98)
        weak, strong = rng.uniform(*self.weak, shape), rng.uniform(*self.strong, shape)
        competence = np.where(rng.random(shape) < self.useless, weak, competence)
        competence = np.where(rng.random(count) < self.all_good, strong, competence)
        competence = np.where(rng.random(count) < self.all_fail, weak, competence)
        good = rng.permutation(techniques)[np.arange(count) % techniques]
        if rng.random() < self.exclusive:
            competence = np.where(np.arange(techniques)[:, None] == good, strong, weak)
        changes = rng.random(queries) < 1.0 / rng.uniform(*self.regime_length)
        regime = np.cumsum(changes, dtype=np.int64)  # (Q,)
        return competence, no_repeats(rng, int(regime[-1]) + 1, count)[regime], regime

    def _seconds(
        self, rng: np.random.Generator, ability: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Log-uniform costs (T,), dealt out by the rank of a noisy reading of the ability."""
        low, high = np.log(self.seconds)
        costs = np.sort(np.exp(rng.uniform(low, high, ability.size)))
        noise = rng.standard_normal(ability.size)
        standard = (ability - ability.mean()) / max(float(ability.std()), 1e-9)
        follow = self.cost_follows_ability
        key = follow * standard + math.sqrt(1.0 - follow**2) * noise
        return np.asarray(costs[np.argsort(np.argsort(key))], dtype=np.float64)

    def _technique_model(self, rng: np.random.Generator) -> TechniqueModel:
        values: dict[str, Any] = {}
        for each in fields(TechniqueModel):
            if each.name.startswith("trend") and not self.trend[1]:
                values[each.name] = 0.0
            else:
                pick = draw_integer if each.name == "dimensions" else draw
                values[each.name] = pick(rng, getattr(self, each.name))
        return TechniqueModel(**values)


POPULATION = Simulation(
    queries=(80, 260),
    map_factor=(1.0, 3.0),
    retimed=0.6,
    techniques=(2, 6),
    ability=(0.45, 0.97),
    useless=0.15,
    all_fail=0.02,
    exclusive=0.05,
)
"""Short routes, most re-timed: what the belief's p̂ is fitted on."""

TOURS = Simulation(
    queries=(150, 500),
    same_length=0.6,
    map_factor=(1.0, 2.0),
    wander=(0.0, 0.8),
    techniques=(2, 5),
    conditions=(2, 6),
    regime_length=(40.0, 100.0),
    ability=(0.45, 0.97),
    useless=0.3,
    weak=(0.0, 0.35),
    all_fail=0.03,
    exclusive=0.1,
    cost_follows_ability=0.5,
    copies=0.03,
    decoy=0.3,
    trend=(0.0, 0.5),
    dimensions=(12, 80),
    smoothness=(0.7, 14.0),
    grain=(0.0, 0.6),
    noise_memory=(1.0, 25.0),
    noise_grain=(0.0, 0.7),
    shift=(0.3, 5.0),
)
"""Steady drives through changing conditions: what SIC's p̂ and its selectors are fitted on."""

TOURS_IN_MOTION = replace(TOURS, queries=(120, 320), retimed=0.5, useless=0.2, decoy=0.15)
"""Half of them re-timed, and somewhat easier: what the belief's selectors are trained on."""


def population(statistic: str) -> Simulation:
    """The routes that selectors of a statistic are trained on: of its own kind of motion."""
    return TOURS_IN_MOTION if statistic == "belief" else TOURS


def simulate(
    seed: int,
    *,
    queries: int = 300,
    references: int | None = None,
    techniques: int = 4,
    motion: Motion = "recorded",
    simulation: Simulation | None = None,
) -> ScoreBank:
    """One simulated route of the given size, the same for the same arguments.

    Args:
        seed: non-negative integer.
        queries: frames Q.
        references: places R; None draws between Q and 2 Q (and often Q itself).
        techniques: T, at most 26; they are called A, B, C, ...
        motion: 'recorded' (the true place advances by one per frame), 'paced' (stops and other
            speeds) or 'kidnapped' (jumps besides).
        simulation: the ranges everything else is drawn from; None: the defaults.

    Raises:
        ValueError: an argument is out of range; the sentence says which.
    """
    frames = whole("queries", queries, 1, most=MOST_FRAMES)
    count = whole("techniques", techniques, 1, most=len(TECHNIQUE_NAMES))
    ranges = replace(
        simulation or Simulation(),
        queries=(frames, frames),
        references=references,
        techniques=(count, count),
        motion=motion,
    )
    return ranges.route(generator(seed), name=f"simulated-{seed}")


def generator(seed: int) -> np.random.Generator:
    """The only source of chance here, from a non-negative integer."""
    return np.random.default_rng(whole("seed", seed, 0))


def bank_of(
    rng: np.random.Generator,
    shared: RouteModel,
    models: list[TechniqueModel],
    seconds: NDArray[np.float64],
    tolerance: int,
    name: str,
    copied: NDArray[np.bool_] | None = None,
) -> ScoreBank:
    """Scores of all techniques, and with the truth of the drive a bank.

    ``copied`` (T,): the technique sees what the one before it sees.
    """
    queries, references = shared.place.size, shared.source.size
    scores = np.empty((len(models), queries, references), np.float32)  # (T, Q, R)
    for t, model in enumerate(models):
        if copied is not None and copied[t]:
            scores[t] = scores[t - 1]
        else:
            write_scores(rng, shared, model, t, scores[t])
    truth = np.floor(shared.place + 0.5).astype(np.int64).clip(0, references - 1)
    truth[shared.leaves if shared.leaves is not None else queries :] = -1
    return ScoreBank(
        scores,
        TECHNIQUE_NAMES[: len(models)],
        seconds,
        tolerance=tolerance,
        ground_truth=truth,
        name=name,
        source="simulated",
    )
