"""The selector's network: shared by all techniques, so that it fits any number and order of them.

Each technique's group of the observation, joined with the route's group, goes through one encoder;
the encodings are pooled over the techniques that are present; one head gives each technique's
logit from its own encoding and the pool, another the value. Permuting the techniques permutes the
actions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from amusic_gym.envs.observation import ROUTE_FEATURES, TECHNIQUE_FEATURES
from amusic_gym.utils.checks import number, whole

VERSION = 1
"""Rises whenever stored weights would mean something else."""

WIDTH = len(TECHNIQUE_FEATURES)
ROUTE_WIDTH = len(ROUTE_FEATURES)
PRESENT = TECHNIQUE_FEATURES.index("present")
ABSENT = -20.0
"""Logit of an empty slot."""

WIDEST = 4096
"""Largest size of a layer: a damaged file must not fill the memory."""


def presence(observation: torch.Tensor) -> torch.Tensor:
    """(B, S) bool, which slots hold a technique, from observations (B, D)."""
    return observation[:, :-ROUTE_WIDTH][:, PRESENT::WIDTH] > 0.5


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the network.

    Attributes:
        hidden: width of the hidden layers.
        encoding: length of a technique's encoding.
        first_logit: logit that every technique starts with. Above 0, learning begins with most
            techniques running and finds out which to leave out; from 0 or below it often ends
            with the cheapest technique for ever.

    Raises:
        ValueError: for a size that is no whole number from 1 to `WIDEST`.
    """

    hidden: int = 64
    encoding: int = 32
    first_logit: float = 1.0

    def __post_init__(self) -> None:
        """Refuse sizes that no network has."""
        for name in ("hidden", "encoding"):
            whole(name, getattr(self, name), 1, most=WIDEST)
        number("first_logit", self.first_logit, "a number")


class SelectorNetwork(nn.Module):
    """Logits (B, S) and values (B, V) from observations (B, S · F + G)."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.latent_dim_pi = 0  # set by the policy: S
        self.latent_dim_vf = config.hidden
        hidden, code = config.hidden, config.encoding
        self.encoder = nn.Sequential(
            nn.Linear(WIDTH + ROUTE_WIDTH, hidden), nn.Tanh(), nn.Linear(hidden, code), nn.Tanh()
        )
        pooled = 2 * code + ROUTE_WIDTH
        self.head = nn.Sequential(nn.Linear(code + pooled, hidden), nn.Tanh(), nn.Linear(hidden, 1))
        self.critic = nn.Sequential(
            nn.Linear(pooled, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh()
        )
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.orthogonal_(module.weight, np.sqrt(2.0))
                nn.init.zeros_(module.bias)
        last = self.head[-1]
        assert isinstance(last, nn.Linear)
        nn.init.orthogonal_(last.weight, 0.01)
        nn.init.constant_(last.bias, config.first_logit)

    def encode(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Encodings (B, S, E), pool (B, P) and presence (B, S)."""
        groups = observation[:, :-ROUTE_WIDTH].unflatten(1, (-1, WIDTH))  # (B, S, F)
        route = observation[:, -ROUTE_WIDTH:]  # (B, G)
        present = groups[:, :, 0]  # (B, S)
        spread = route.unsqueeze(1).expand(-1, groups.shape[1], -1)  # (B, S, G)
        codes = self.encoder(torch.cat([groups, spread], dim=2))  # (B, S, E)
        weight = present.unsqueeze(2)
        mean = (codes * weight).sum(1) / weight.sum(1).clamp(min=1.0)
        highest = (codes - 2.0 * (1.0 - weight)).amax(1)  # tanh keeps codes above −1
        return codes, torch.cat([mean, highest, route], dim=1), present

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, S) logits of running each technique."""
        return self._logits(*self.encode(observation))

    def _logits(
        self, codes: torch.Tensor, pool: torch.Tensor, present: torch.Tensor
    ) -> torch.Tensor:
        spread = pool.unsqueeze(1).expand(-1, codes.shape[1], -1)  # (B, S, P)
        logits = self.head(torch.cat([codes, spread], dim=2)).squeeze(2)
        return torch.where(present > 0.5, logits, torch.full_like(logits, ABSENT))

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (B, S) and the critic's features (B, V)."""
        codes, pool, present = self.encode(observation)
        return self._logits(codes, pool, present), self.critic(pool)

    def forward_actor(self, observation: torch.Tensor) -> torch.Tensor:
        """Logits (B, S)."""
        return self.logits(observation)

    def forward_critic(self, observation: torch.Tensor) -> torch.Tensor:
        """The critic's features (B, V)."""
        features: torch.Tensor = self.critic(self.encode(observation)[1])
        return features


@dataclass(frozen=True)
class SetSizes:
    """Sizes of a network.

    Attributes:
        hidden: width of the hidden layers.
        encoding: length of a technique's encoding.

    Raises:
        ValueError: for a size that is no whole number from 1 to `WIDEST`.
    """

    hidden: int = 64
    encoding: int = 32

    def __post_init__(self) -> None:
        """Refuse sizes that no network has."""
        for name, size in vars(self).items():
            whole(name, size, 1, most=WIDEST)


class SetEncoder(nn.Module):
    """Encodes every technique by the same layers, and all together by mean and maximum.

    Args:
        sizes: of the layers.
    """

    def __init__(self, sizes: SetSizes) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *(nn.Linear(WIDTH + ROUTE_WIDTH, sizes.hidden), nn.Tanh()),
            *(nn.Linear(sizes.hidden, sizes.encoding), nn.Tanh()),
        )
        self.pooled = 2 * sizes.encoding + ROUTE_WIDTH  # P

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Encodings (B, S, E), zero where absent, and the pool (B, P) of observations (B, D)."""
        present = presence(observation).unsqueeze(2)  # (B, S, 1)
        groups = observation[:, :-ROUTE_WIDTH].unflatten(1, (-1, WIDTH))  # (B, S, F)
        route = observation[:, -ROUTE_WIDTH:]  # (B, G)
        spread = route.unsqueeze(1).expand(-1, groups.shape[1], -1)  # (B, S, G)
        codes = self.layers(torch.cat([groups, spread], dim=2)) * present  # (B, S, E)
        mean = codes.sum(1) / present.sum(1).clamp(min=1)
        highest = torch.where(present, codes, -torch.ones_like(codes)).amax(1)  # tanh is above −1
        return codes, torch.cat([mean, highest, route], dim=1)


def build_around(policy: Any, network: nn.Module, lr_schedule: Any) -> None:
    """Build an actor-critic policy around a network that gives the logits itself.

    Args:
        policy: of Stable-Baselines3; what its ``_build`` is called on.
        network: gives logits and the critic's features, of length ``latent_dim_vf``.
        lr_schedule: share of the training that is left → learning rate.
    """
    policy.mlp_extractor = network
    policy.action_net = nn.Identity()
    policy.value_net = nn.Linear(network.latent_dim_vf, 1)  # type: ignore[arg-type]
    policy.value_net.apply(partial(policy.init_weights, gain=1.0))
    rate = lr_schedule(1)
    policy.optimizer = policy.optimizer_class(
        policy.parameters(), lr=rate, **policy.optimizer_kwargs
    )


class SelectorPolicy(ActorCriticPolicy):
    """Stable-Baselines3's actor-critic policy around :class:`SelectorNetwork`."""

    def __init__(
        self,
        observation_space: gym.Space,
        action_space: gym.Space,
        lr_schedule: Any,
        config: NetworkConfig | None = None,
        **arguments: Any,
    ) -> None:
        self.config = config or NetworkConfig()
        super().__init__(observation_space, action_space, lr_schedule, **arguments)

    def _build(self, lr_schedule: Any) -> None:
        network = SelectorNetwork(self.config)
        network.latent_dim_pi = self.action_space.shape[0]  # type: ignore[index]
        build_around(self, network, lr_schedule)
