"""Contestants of small comparisons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from amusic_baselines import make_policy
from rollout_cases import Cycle

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.contestants import Contestant
from amusic_gym.policies.protocol import Context


class Weighted(Cycle):
    """Runs as many techniques as its compute weight says."""

    def act(self, observation, info):
        slots = info["present"].shape[1]
        return np.arange(slots) < info["compute_weight"][:, None]


def weighted(context: Context) -> Weighted:
    return Weighted(statistic="mean")


class Lineup:
    """The contestants of a test; counts how often each is run."""

    def __init__(self, *names: str, weights: Sequence[float] = (), version: str = "") -> None:
        self.names = names
        self.weights = tuple(weights)
        self.version = version
        self.runs: list[str] = []

    def make(self, name: str, context: Context):
        policy = weighted(context) if name == "weighted" else make_policy(name, context)
        reset, runs = policy.reset, self.runs

        def counted(*arguments):
            runs.append(f"{context.bank.name} {name}")
            reset(*arguments)

        policy.reset = counted
        return policy

    def __call__(self, bank: ScoreBank) -> list[Contestant]:
        return [
            Contestant(
                name,
                lambda context, name=name: self.make(name, context),
                self.weights if name == "weighted" else (None,),
                self.version,
            )
            for name in self.names
        ]
