"""PPO with a bit per technique, and the network that fits any number of them."""

from __future__ import annotations

from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm

from amusic_agents.adapter import SB3VecEnv
from amusic_agents.config import TrainingConfig
from amusic_agents.learners import Learner
from amusic_agents.learners.common import make_env, ppo_arguments
from amusic_agents.network import SelectorNetwork, SelectorPolicy
from amusic_gym.envs.sources import RouteSource


def make_model(config: TrainingConfig, source: RouteSource) -> PPO:
    """PPO on the native vector environment, on one thread, seeded."""
    env = SB3VecEnv(make_env(config, source))
    arguments = ppo_arguments(config)
    return PPO(SelectorPolicy, env, policy_kwargs={"config": config.network}, **arguments)


def network(model: BaseAlgorithm) -> SelectorNetwork:
    """The network of a model."""
    found = model.policy.mlp_extractor
    assert isinstance(found, SelectorNetwork)
    return found


LEARNER = Learner("selector", make_model, network, lambda config: config.network)
