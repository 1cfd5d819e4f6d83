"""DQN over subsets: the value of every subset of techniques, the best one runs."""

from __future__ import annotations

from typing import Any

from stable_baselines3 import DQN
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork

from agents.config import TrainingConfig
from agents.learners import Learner
from agents.learners.common import make_env
from agents.learners.sets import SetSizes
from agents.learners.subsets import SubsetNetwork, SubsetVecEnv
from amusic_gym.sources import RouteSource

BUFFER = 200_000
"""Frames to learn from again; they are not in the checkpoint, so a resume begins with none."""

RANDOM_FRAMES = 10_000
"""Frames before the first update, at most a tenth of the training."""

EXPLORATION = (0.3, 0.02)
"""Share of the training in which the chance of a random subset falls from 1, and where it ends."""

STEPS_BETWEEN = 4
"""Steps of all routes between two updates."""

TARGET_EVERY = 10_000
"""Frames between two copies of the network into the target network."""


class SubsetQPolicy(DQNPolicy):
    """DQN's policy around :class:`SubsetNetwork`."""

    def __init__(self, *arguments: Any, sizes: SetSizes, **keywords: Any) -> None:
        self.sizes = sizes
        super().__init__(*arguments, **keywords)

    def make_q_net(self) -> QNetwork:
        """Stable-Baselines3's, its layers replaced."""
        made = super().make_q_net()
        made.q_net = SubsetNetwork(self.sizes)  # type: ignore[assignment]
        return made.to(self.device)


def make_model(config: TrainingConfig, source: RouteSource) -> DQN:
    """DQN on the native vector environment; as many frames go through an update as with PPO."""
    frames = STEPS_BETWEEN * config.n_envs
    return DQN(
        SubsetQPolicy,
        SubsetVecEnv(make_env(config, source)),
        policy_kwargs={"sizes": SetSizes()},
        learning_rate=lambda left: config.learning_rate * left,
        buffer_size=BUFFER,
        learning_starts=min(RANDOM_FRAMES, config.timesteps // 10),
        batch_size=config.batch_size,
        gamma=config.reward_discount,
        train_freq=(STEPS_BETWEEN, "step"),
        gradient_steps=max(1, round(config.epochs * frames / config.batch_size)),
        target_update_interval=max(TARGET_EVERY, config.n_envs),
        exploration_fraction=EXPLORATION[0],
        exploration_final_eps=EXPLORATION[1],
        seed=config.seed,
        device="cpu",
    )


def network(model: BaseAlgorithm) -> SubsetNetwork:
    """The network of a model."""
    assert isinstance(model, DQN)
    found = model.q_net.q_net
    assert isinstance(found, SubsetNetwork)
    return found


LEARNER = Learner("subsets", make_model, network, lambda config: SetSizes())
