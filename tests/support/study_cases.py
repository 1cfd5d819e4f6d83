"""Entrants and plans of small studies."""

from __future__ import annotations

import os
import signal
from functools import partial
from pathlib import Path

import numpy as np
from amusic_baselines import make_policy
from env_cases import random_bank
from rollout_cases import Cycle

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation import study
from amusic_gym.evaluation.contestants import Contestant
from amusic_gym.evaluation.study import Entrant
from amusic_gym.policies.protocol import Context

WEIGHTS = (0.1, 1.0, 8.0)


class Weighted(Cycle):
    """Runs one technique, or all while λ is small; its seed decides which one."""

    def __init__(self, seed: int) -> None:
        super().__init__(statistic="evidence")
        self.seed = seed

    def act(self, observation, info):
        slots = info["present"].shape[1]
        every = info["compute_weight"][:, None] < 0.5
        return every | (np.arange(slots) == self.seed % slots)


def make_weighted(seed: int, context: Context) -> Weighted:
    return Weighted(seed)


class Killer(Weighted):
    """As `Weighted`, but the first to act kills its process, unless the marker is there."""

    def __init__(self, marker: Path) -> None:
        super().__init__(1)
        self.marker = marker

    def act(self, observation, info):
        if not self.marker.exists():
            self.marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().act(observation, info)


def make_killer(marker: Path, context: Context) -> Killer:
    return Killer(marker)


def entrant(spec: str, family: str = "peer", **options) -> Entrant:
    maker = partial(make_policy, spec)
    return Entrant(spec, family, (Contestant(spec, maker),), **options)


def learned(name: str, seeds: int = 2, weights: tuple[float, ...] = WEIGHTS) -> Entrant:
    runs = [
        Contestant(f"{name}{seed}", partial(make_weighted, seed), weights) for seed in range(seeds)
    ]
    return Entrant(name, "learned", tuple(runs))


FIXED = [
    entrant(spec, "fixed")
    for spec in ("single:T0", "single:T1", "single:T2", "subset:T0+T1", "music")
]


EVERYBODY = [
    *FIXED,
    entrant("amusic", "amusic"),
    entrant("cascade", "cascade"),
    entrant("random:0.5", "random", draws=True),
    entrant("oracle", "bound", needs_truth="of the route itself"),
    entrant("raw:T0"),
    Entrant(
        "music@mean",
        "variant",
        (Contestant("music", partial(make_policy, "music")),),
        statistic="mean",
    ),
    learned("imitation"),
    learned("PPO"),
]


def banks(count: int = 2) -> list[ScoreBank]:
    return [random_bank(seed, queries=30, references=40) for seed in range(1, count + 1)]


def plan_of(entrants, routes=None, **options) -> study.Plan:
    options = {"seeds": (0, 1), "statistic": "evidence", **options}
    return study.make_plan(routes or banks(), lambda bank: list(entrants), **options)
