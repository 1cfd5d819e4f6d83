"""What several algorithms share: the environment to learn in, and fitting a network."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn

from amusic_agents.config import ImitationConfig, RolloutConfig, TrainingConfig
from amusic_gym.envs.sources import RouteSource
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv


def make_env(
    config: TrainingConfig,
    source: RouteSource,
    env_type: type[TechniqueSelectionVectorEnv] = TechniqueSelectionVectorEnv,
    **arguments: Any,
) -> TechniqueSelectionVectorEnv:
    """The environment to learn in, with other ``arguments``, and one thread for PyTorch."""
    torch.set_num_threads(1)  # small batches: more threads only wait for each other
    return env_type(
        config.n_envs,
        source,
        slots=source.slots,
        statistic=config.statistic,
        reward=config.reward,
        compute_weight=config.compute_weights,
        threads=config.threads,
        autoreset_mode="SameStep",
        **{**config.environment(), **arguments},
    )


def fit(
    network: nn.Module,
    loss_of: Callable[[torch.Tensor], torch.Tensor],
    examples: int,
    batches: int,
    settings: ImitationConfig | RolloutConfig,
    rng: np.random.Generator,
    weight_decay: float = 0.0,
) -> float:
    """Fit a network by Adam, its learning rate falling linearly to zero; the last pass's loss.

    ``loss_of`` gives the loss of a batch, from the numbers (B,) of its examples; these are cut into
    ``batches`` in each pass, in an order that ``rng`` draws.
    """
    steps = settings.epochs * batches
    optimiser = torch.optim.Adam(network.parameters(), weight_decay=weight_decay)
    losses = np.zeros(steps)
    for step in range(steps):
        if step % batches == 0:
            order = torch.from_numpy(rng.permutation(examples))
        optimiser.param_groups[0]["lr"] = settings.learning_rate * (1.0 - step / steps)
        loss = loss_of(order[step % batches :: batches])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses[step] = loss.detach()
    return float(losses[-batches:].mean())
