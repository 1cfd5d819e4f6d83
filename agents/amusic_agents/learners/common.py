"""What several learners share: the environment, and PPO's arguments."""

from __future__ import annotations

from typing import Any

import torch

from amusic_agents.config import TrainingConfig
from amusic_gym.envs.sources import RouteSource
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv


def make_env(
    config: TrainingConfig,
    source: RouteSource,
    kind: type[TechniqueSelectionVectorEnv] = TechniqueSelectionVectorEnv,
    *,
    reselection: int | None = None,
) -> TechniqueSelectionVectorEnv:
    """The environment to learn in, and one thread for PyTorch.

    Args:
        config: how many routes, how SIC works, which λ.
        source: the routes.
        kind: the environment's class.
        reselection: M of the re-select bit; None: no such bit.
    """
    torch.set_num_threads(1)  # small batches: more threads only wait for each other
    arguments: dict[str, Any] = config.environment()
    return kind(
        config.n_envs,
        source,
        slots=source.slots,
        statistic=config.statistic,
        **arguments,
        reward=config.reward,
        compute_weight=config.compute_weights,
        threads=config.threads,
        reselection=reselection,
        autoreset_mode="SameStep",
    )


def ppo_arguments(config: TrainingConfig) -> dict[str, Any]:
    """Arguments of PPO and its relatives."""
    return {
        "n_steps": config.n_steps,
        "batch_size": config.batch,
        "n_epochs": config.epochs,
        "learning_rate": lambda left: config.learning_rate * left,
        "gamma": config.reward_discount,
        "gae_lambda": config.gae_lambda,
        "ent_coef": config.entropy,
        "seed": config.seed,
        "device": "cpu",
    }
