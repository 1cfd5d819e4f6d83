"""Reward of a step: terms by name, summed. A user's own is one callable of the same form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_gym.envs.outcome import Outcome


class RewardInputs(NamedTuple):
    """What a reward may look at; every array has one entry per route (N,).

    It may be kept: no later step writes to it.

    Attributes:
        outcome: all that the step gave; ``outcome.routes`` and ``outcome.slots`` are record
            arrays whose fields :mod:`amusic_gym.envs.outcome` lists.
        compute_weight: (N,) λ of each route.
        correct: call it for (N,) whether the predictions are true. Ground truth: for study only.
    """

    outcome: Outcome
    compute_weight: NDArray[np.float64]
    correct: Callable[[], NDArray[np.bool_]]


Reward = Callable[[RewardInputs], Mapping[str, NDArray[np.float64]]]

Terms = dict[str, NDArray[np.float64]]
"""Terms of a reward by name, each (N,)."""

Number = TypeVar("Number", float, NDArray[np.float64])


def trade(correctness: Number, compute: Number, compute_weight: Number) -> dict[str, Number]:
    """Correctness and −λ · compute: the terms of the rewards that come with the environment."""
    return {"correctness": correctness, "compute": -compute_weight * compute}


def estimated(inputs: RewardInputs) -> dict[str, NDArray[np.float64]]:
    """p̂ − λ · (seconds of the step / Σ seconds): needs no ground truth."""
    routes = inputs.outcome.routes
    return trade(routes["p_correct"], routes["compute"], inputs.compute_weight)


def ground_truth(inputs: RewardInputs) -> dict[str, NDArray[np.float64]]:
    """1 for a true place − λ · compute: for study, never the default."""
    routes = inputs.outcome.routes
    return trade(inputs.correct().astype(np.float64), routes["compute"], inputs.compute_weight)


REWARDS: dict[str, Reward] = {"estimated": estimated, "ground_truth": ground_truth}


def as_reward(reward: str | Reward) -> Reward:
    """Look a reward up by name, or take a callable as it is.

    Raises:
        ValueError: for an unknown name.
    """
    if callable(reward):
        return reward
    if reward not in REWARDS:
        raise ValueError(suggest("reward", reward, tuple(REWARDS)))
    return REWARDS[reward]
