"""RecurrentPPO (sb3-contrib): the network carries a memory (LSTM) from frame to frame.

sb3-contrib fails on `MultiBinary`, so a bit is a choice among two, `MultiDiscrete([2] * S)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import RecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from agents.adapter import SB3VecEnv
from agents.config import TrainingConfig
from agents.learners import Kind, Learner
from agents.learners.common import make_env, ppo_arguments
from agents.learners.sets import SetEncoder, SetSizes, presence
from agents.network import ABSENT
from amusic_gym.policy import Needs
from amusic_gym.sources import RouteSource

Memory = tuple[torch.Tensor, torch.Tensor]
"""Hidden and cell state, each (1, N, M)."""

FIRST_LOGIT = 1.0
"""Logit that every technique starts with: learning begins with most of them running."""


@dataclass(frozen=True)
class RecurrentSizes(SetSizes):
    """Sizes of the network; ``memory``: length of the LSTM's state."""

    memory: int = 64


class _Remembering(nn.Module):
    """The encoder and an LSTM over the pool; to sb3-contrib it looks like an LSTM itself."""

    num_layers = 1

    def __init__(self, sizes: RecurrentSizes, input_size: int) -> None:
        super().__init__()
        self.input_size = input_size
        self.hidden_size = sizes.memory
        self.encoder = SetEncoder(sizes)
        self.lstm = nn.LSTM(self.encoder.pooled, sizes.memory)

    def remember(
        self, observations: torch.Tensor, memory: Memory
    ) -> tuple[torch.Tensor, torch.Tensor, Memory]:
        """Encodings (L · N, S, E) and states (L, N, M) of sequences (L, N, D), and the last."""
        codes, pool = self.encoder(observations.flatten(0, 1))
        states, memory = self.lstm(pool.unflatten(0, observations.shape[:2]), memory)
        return codes, states, memory


class RecurrentNetwork(_Remembering):
    """Logits of sequences: every technique's from its encoding and the memory.

    Args:
        sizes: of the layers.
        input_size: D, length of the observation, which only sb3-contrib asks for.
    """

    def __init__(self, sizes: RecurrentSizes, input_size: int = 0) -> None:
        super().__init__(sizes, input_size)
        last = nn.Linear(sizes.hidden, 1)
        nn.init.orthogonal_(last.weight, 0.01)
        nn.init.constant_(last.bias, FIRST_LOGIT)
        first = nn.Linear(sizes.encoding + sizes.memory, sizes.hidden)
        self.head = nn.Sequential(first, nn.Tanh(), last)

    def logits(self, observations: torch.Tensor, memory: Memory) -> tuple[torch.Tensor, Memory]:
        """Logits (L, N, S) of sequences of observations (L, N, D), and the last memory."""
        codes, states, memory = self.remember(observations, memory)
        spread = states.flatten(0, 1).unsqueeze(1).expand(-1, codes.shape[1], -1)  # (L · N, S, M)
        logits = self.head(torch.cat([codes, spread], dim=2)).squeeze(2)  # (L · N, S)
        logits = logits.masked_fill(~presence(observations.flatten(0, 1)), ABSENT)
        return logits.unflatten(0, observations.shape[:2]), memory

    def forward(self, observations: torch.Tensor, memory: Memory) -> tuple[torch.Tensor, Memory]:
        """Logits (L, N, 2 · S) of staying off and of running, technique by technique."""
        logits, memory = self.logits(observations, memory)
        return torch.stack([torch.zeros_like(logits), logits], dim=3).flatten(2), memory


class RecurrentCritic(_Remembering):
    """The critic's features: the memory of an LSTM of its own."""

    def forward(self, observations: torch.Tensor, memory: Memory) -> tuple[torch.Tensor, Memory]:
        """Features (L, N, M) of sequences of observations (L, N, D), and the last memory."""
        _, states, memory = self.remember(observations, memory)
        return states, memory


class SetLstmPolicy(RecurrentActorCriticPolicy):
    """The policy of sb3-contrib around :class:`RecurrentNetwork`."""

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.MultiDiscrete,
        lr_schedule: Any,
        sizes: RecurrentSizes,
        **arguments: Any,
    ) -> None:
        arguments |= {"net_arch": [], "lstm_hidden_size": sizes.memory}
        super().__init__(observation_space, action_space, lr_schedule, **arguments)
        size = int(np.prod(observation_space.shape))
        self.lstm_actor = RecurrentNetwork(sizes, size)  # type: ignore[assignment]
        self.lstm_critic = RecurrentCritic(sizes, size)  # type: ignore[assignment]
        self.action_net = nn.Identity()  # the network gives the logits themselves
        rate = lr_schedule(1)
        self.optimizer = self.optimizer_class(self.parameters(), lr=rate, **self.optimizer_kwargs)  # type: ignore[call-arg]


class BitwiseVecEnv(SB3VecEnv):
    """The environment with a choice among two per technique, `MultiDiscrete([2] * S)`."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.action_space = spaces.MultiDiscrete([2] * env.task.slots)


class RecurrentSelector:
    """Runs the techniques that the network would rather run than not, with a memory per route.

    Args:
        network: the network.
        statistic: SIC's statistic that it was trained on.
        environment: other arguments of the environment that it was trained on.
    """

    def __init__(
        self,
        network: RecurrentNetwork,
        statistic: str,
        environment: Mapping[str, Any] | None = None,
    ) -> None:
        self.network = network
        self.needs = Needs(statistic=statistic, extra=dict(environment or {}))
        self._memory = self._blank(0)

    def _blank(self, routes: int) -> Memory:
        shape = (1, routes, self.network.hidden_size)
        return torch.zeros(shape), torch.zeros(shape)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Forget the routes of ``mask``."""
        if self._memory[0].shape[1] != mask.size:
            self._memory = self._blank(mask.size)
        for state in self._memory:
            state[:, torch.from_numpy(mask)] = 0.0

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The more likely value of every bit, (N, S)."""
        seen = torch.from_numpy(observation).unsqueeze(0)  # (1, N, D)
        with torch.no_grad():
            logits, self._memory = self.network.logits(seen, self._memory)
        return logits[0].numpy() > 0.0


def make_model(config: TrainingConfig, source: RouteSource) -> RecurrentPPO:
    """RecurrentPPO on the native vector environment."""
    return RecurrentPPO(
        SetLstmPolicy,
        BitwiseVecEnv(make_env(config, source)),
        policy_kwargs={"sizes": RecurrentSizes()},
        **ppo_arguments(config),
    )


def network(model: BaseAlgorithm) -> RecurrentNetwork:
    """The network of a model."""
    found = model.policy.lstm_actor
    assert isinstance(found, RecurrentNetwork)
    return found


KIND = Kind("recurrent", RecurrentSizes, RecurrentNetwork, RecurrentSelector)
LEARNER = Learner("recurrent", make_model, network, lambda config: RecurrentSizes())
