"""MaskablePPO (sb3-contrib): one choice among all subsets; those that cannot run are masked.

PPO chooses every bit for itself, given the observation; here the bits are drawn together.
"""

from __future__ import annotations

from typing import Any

import torch
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from agents.config import TrainingConfig
from agents.learners import Learner
from agents.learners.common import make_env, ppo_arguments
from agents.learners.sets import SetEncoder, SetSizes
from agents.learners.subsets import SubsetNetwork, SubsetVecEnv
from agents.network import build_around
from amusic_gym.sources import RouteSource


class _ActorCritic(nn.Module):
    """Ratings of all subsets, and the critic's features from an encoder of its own."""

    def __init__(self, sizes: SetSizes) -> None:
        super().__init__()
        self.actor = SubsetNetwork(sizes)
        nn.init.orthogonal_(self.actor.value.weight, 0.01)  # at first all subsets are alike
        self.encoder = SetEncoder(sizes)
        self.critic = nn.Sequential(nn.Linear(self.encoder.pooled, sizes.hidden), nn.Tanh())
        self.latent_dim_vf = sizes.hidden

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Ratings (B, 2^S) and the critic's features (B, H)."""
        return self.forward_actor(observation), self.forward_critic(observation)

    def forward_actor(self, observation: torch.Tensor) -> torch.Tensor:
        """Ratings (B, 2^S)."""
        ratings: torch.Tensor = self.actor(observation)
        return ratings

    def forward_critic(self, observation: torch.Tensor) -> torch.Tensor:
        """The critic's features (B, H)."""
        features: torch.Tensor = self.critic(self.encoder(observation)[1])
        return features


class MaskableSubsetPolicy(MaskableActorCriticPolicy):
    """The policy of sb3-contrib around :class:`SubsetNetwork`."""

    def __init__(self, *arguments: Any, sizes: SetSizes, **keywords: Any) -> None:
        self.sizes = sizes
        super().__init__(*arguments, **keywords)

    def _build(self, lr_schedule: Any) -> None:
        build_around(self, _ActorCritic(self.sizes), lr_schedule)


def make_model(config: TrainingConfig, source: RouteSource) -> MaskablePPO:
    """MaskablePPO on the native vector environment."""
    return MaskablePPO(
        MaskableSubsetPolicy,
        SubsetVecEnv(make_env(config, source)),
        policy_kwargs={"sizes": SetSizes()},
        **ppo_arguments(config),
    )


def network(model: BaseAlgorithm) -> SubsetNetwork:
    """The network of a model."""
    found = model.policy.mlp_extractor
    assert isinstance(found, _ActorCritic)
    return found.actor


LEARNER = Learner("subsets", make_model, network, lambda config: SetSizes())
