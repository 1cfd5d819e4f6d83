"""A selector that decides only *when* to select again: future work of A-MuSIC (its conclusions).

What is selected is the paper's rule (III-C1), through the environment's re-select bit; the learned
decision, at every frame, takes the place of its t-test. As in the paper, all techniques run for the
first M frames, then comes a selection; the selected techniques run until the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from amusic_agents.adapter import SB3VecEnv
from amusic_agents.config import TrainingConfig
from amusic_agents.learners import Kind, Learner
from amusic_agents.learners.common import make_env, ppo_arguments
from amusic_agents.learners.driver import NetworkSelector
from amusic_agents.network import SetEncoder, SetSizes, build_around
from amusic_gym.envs.sources import RouteSource
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.settings import BLOCK

FIRST_LOGIT = -3.5
"""Logit of selecting again before any training: once in 34 frames, for a selection is dear."""

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
"""Multiples of it, without their whole part, fill [0, 1) evenly, however many are taken."""


@dataclass(frozen=True)
class ReselectSizes(SetSizes):
    """Sizes of the network; ``block``: M, the frames that a selection looks at."""

    block: int = BLOCK


class HeldSelection:
    """The techniques of each route's last selection: all, until there is one.

    Args:
        block: M; after so many frames comes the first selection, and none before.
    """

    def __init__(self, block: int) -> None:
        self.block = block
        self._selected = np.zeros((0, 0), np.bool_)  # (N, S)
        self._frames = np.zeros(0, np.int64)  # (N,) seen so far

    def note(self, info: Mapping[str, Any]) -> None:
        """Take in the infos of a reset or step."""
        present, selection = info["present"], info["selection"]
        if self._selected.shape != present.shape:
            self._selected = present.copy()
        self._frames = info["frame"] + 1
        fresh, happened = self._frames == 0, selection["happened"]
        self._selected[happened] = selection["selected"][happened]
        self._selected[fresh] = present[fresh]

    def actions(self, reselect: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The environment's actions (N, S + 1) from the decisions (N,)."""
        later = (self._frames > self.block) & reselect
        return np.column_stack([self._selected, later | (self._frames == self.block)])


class ReselectNetwork(nn.Module):
    """Logits (B,) of selecting again from observations (B, D).

    Args:
        sizes: of the layers.
    """

    def __init__(self, sizes: ReselectSizes) -> None:
        super().__init__()
        self.block = sizes.block
        self.encoder = SetEncoder(sizes)
        self.latent_dim_vf = sizes.hidden
        self.hidden = nn.Sequential(nn.Linear(self.encoder.pooled, sizes.hidden), nn.Tanh())
        self.last = nn.Linear(sizes.hidden, 1)
        self.critic = nn.Sequential(nn.Linear(self.encoder.pooled, sizes.hidden), nn.Tanh())
        nn.init.orthogonal_(self.last.weight, 0.01)
        nn.init.constant_(self.last.bias, FIRST_LOGIT)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """(B,) logits of selecting again."""
        return self._logits(self.encoder(observation)[1])

    def _logits(self, pool: torch.Tensor) -> torch.Tensor:
        logits: torch.Tensor = self.last(self.hidden(pool))
        return logits.squeeze(1)

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (B, 2) of going on and of selecting again, and the critic's features (B, H)."""
        return self.forward_actor(observation), self.forward_critic(observation)

    def forward_actor(self, observation: torch.Tensor) -> torch.Tensor:
        """Logits (B, 2) of going on and of selecting again."""
        logits = self.logits(observation)
        return torch.stack([torch.zeros_like(logits), logits], dim=1)

    def forward_critic(self, observation: torch.Tensor) -> torch.Tensor:
        """The critic's features (B, H)."""
        features: torch.Tensor = self.critic(self.encoder(observation)[1])
        return features


class ReselectPolicy(ActorCriticPolicy):
    """Stable-Baselines3's policy around :class:`ReselectNetwork`."""

    def __init__(self, *arguments: Any, sizes: ReselectSizes, **keywords: Any) -> None:
        self.sizes = sizes
        super().__init__(*arguments, **keywords)

    def _build(self, lr_schedule: Any) -> None:
        build_around(self, ReselectNetwork(self.sizes), lr_schedule)


class HoldingVectorEnv(TechniqueSelectionVectorEnv):
    """The environment with one bit, `Discrete(2)`: whether to select again.

    Args:
        arguments: the environment's; ``reselection`` among them.
    """

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._held = HeldSelection(self.task.block)
        self.single_action_space: spaces.Space = spaces.Discrete(2)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, **arguments: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode on every route."""
        observation, info = super().reset(**arguments)
        self._held.note(info)
        return observation, info

    def step(self, actions: ArrayLike) -> tuple[Any, ...]:
        """Step every route with its decision (N,)."""
        result = super().step(self._held.actions(np.asarray(actions) == 1))
        self._held.note(result[4])
        return result


class ReselectSelector(NetworkSelector[ReselectNetwork]):
    """Keeps the selected techniques and selects again at the network's rate.

    What is learned is a rate: in trouble perhaps once in ten frames, else hardly ever. Taking the
    likelier value of the bit, as other selectors do, would never select again. So the chance is
    compared with numbers that spread evenly over [0, 1), the same on every route. Nothing is
    forgotten at a reset: the infos say where a route has just begun.
    """

    def __init__(
        self, network: ReselectNetwork, statistic: str, environment: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(network, statistic, environment, reselection=network.block)
        self._held = HeldSelection(network.block)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The selected techniques and the re-select bit, (N, S + 1)."""
        self._held.note(info)
        with torch.no_grad():
            chance = torch.sigmoid(self.network.logits(torch.from_numpy(observation))).numpy()
        return self._held.actions(chance > (info["frame"] + 1) * GOLDEN % 1.0)


def make_model(config: TrainingConfig, source: RouteSource) -> PPO:
    """PPO on the native vector environment with its re-select bit."""
    sizes = ReselectSizes()
    env = SB3VecEnv(make_env(config, source, HoldingVectorEnv, reselection=sizes.block))
    return PPO(ReselectPolicy, env, policy_kwargs={"sizes": sizes}, **ppo_arguments(config))


def network(model: BaseAlgorithm) -> ReselectNetwork:
    """The network of a model."""
    found = model.policy.mlp_extractor
    assert isinstance(found, ReselectNetwork)
    return found


KIND = Kind("reselect", ReselectSizes, ReselectNetwork, ReselectSelector)
LEARNER = Learner("reselect", make_model, network, lambda config: ReselectSizes())
