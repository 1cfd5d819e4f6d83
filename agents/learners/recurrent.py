"""RecurrentPPO (sb3-contrib): the network carries a memory from frame to frame.

sb3-contrib fails on `MultiBinary`, so a bit is a choice among two, `MultiDiscrete([2] * S)`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from sb3_contrib import RecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from agents.adapter import SB3VecEnv
from agents.config import TrainingConfig
from agents.learners import Learner
from agents.learners.common import make_env, ppo_arguments
from agents.learners.memory import RecurrentCritic, RecurrentNetwork, RecurrentSizes
from amusic_gym.sources import RouteSource


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


LEARNER = Learner("recurrent", make_model, network, lambda config: RecurrentSizes())
