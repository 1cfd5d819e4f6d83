"""The networks' common parts: shared by all techniques, so that they fit any number and order.

Each technique's group of the observation, joined with the route's group, goes through one encoder;
the encodings are pooled over the techniques that are present.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from amusic_agents.config import NetworkConfig, SetSizes
from amusic_gym.envs.observation import (
    ROUTE_FEATURES,
    TECHNIQUE_FEATURES,
    limit_compute_weight,
)
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.policies.protocol import Needs

VERSION = 1  # rises whenever stored weights of any network would mean something else
WIDTH = len(TECHNIQUE_FEATURES)
ROUTE_WIDTH = len(ROUTE_FEATURES)
PRESENT = TECHNIQUE_FEATURES.index("present")
ABSENT = -20.0  # logit of an empty slot


def presence(observation: torch.Tensor) -> torch.Tensor:
    """(B, S) bool, which slots hold a technique, from observations (B, D)."""
    return observation[:, :-ROUTE_WIDTH][:, PRESENT::WIDTH] > 0.5


class SetEncoder(nn.Sequential):
    """Encodes every technique by the same layers, and all together by mean and maximum."""

    def __init__(self, sizes: SetSizes) -> None:
        super().__init__(
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
        codes = super().forward(torch.cat([groups, spread], dim=2)) * present  # (B, S, E)
        mean = codes.sum(1) / present.sum(1).clamp(min=1)
        highest = torch.where(present, codes, -torch.ones_like(codes)).amax(1)  # tanh is above −1
        return codes, torch.cat([mean, highest, route], dim=1)


class SelectorNetwork(nn.Module):
    """Logits (B, S) and the critic's features (B, V) from observations (B, D).

    One head gives each technique's logit from its own encoding and the pool, another the features.
    Permuting the techniques permutes the logits.
    """

    def __init__(self, sizes: NetworkConfig) -> None:
        super().__init__()
        self.sizes = sizes
        self.latent_dim_vf = hidden = sizes.hidden  # V
        self.encoder = SetEncoder(sizes)
        pooled = self.encoder.pooled
        self.head = nn.Sequential(
            nn.Linear(sizes.encoding + pooled, hidden), nn.Tanh(), nn.Linear(hidden, 1)
        )
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
        nn.init.constant_(last.bias, sizes.first_logit)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, S) logits of running each technique."""
        return self._logits(observation, *self.encoder(observation))

    def _logits(
        self, observation: torch.Tensor, codes: torch.Tensor, pool: torch.Tensor
    ) -> torch.Tensor:
        spread = pool.unsqueeze(1).expand(-1, codes.shape[1], -1)  # (B, S, P)
        logits = self.head(torch.cat([codes, spread], dim=2)).squeeze(2)
        return torch.where(presence(observation), logits, torch.full_like(logits, ABSENT))

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (B, S) and the critic's features (B, V)."""
        codes, pool = self.encoder(observation)
        return self._logits(observation, codes, pool), self.critic(pool)

    forward_actor = logits  # as Stable-Baselines3 calls it

    def forward_critic(self, observation: torch.Tensor) -> torch.Tensor:
        """The critic's features (B, V)."""
        return self.critic(self.encoder(observation)[1])


class NetworkSelector(ABC):
    """A policy that acts as a trained network says.

    Attributes:
        compute_weights: range of λ that it acts at; at any other λ it acts as at the nearest end.
            None: no such range.

    Args:
        network: the network.
        statistic: SIC's statistic that it was trained on.
        environment: other arguments of the environment that it was trained on; ``carry`` and
            ``discount`` are as the statistic has them where they are not among these.
        reselection: M of the environment's re-select bit; None: it has none.
    """

    kind: ClassVar[str]  # the kind's name in the file of the weights
    # dataclass of the network's sizes; refuses those that no network has
    sizes_type: ClassVar[type[Any]]
    network_type: ClassVar[type[Any]]  # makes a network of such sizes
    compute_weights: tuple[float, float] | None = None

    def __init__(
        self,
        network: Any,
        statistic: str,
        environment: Mapping[str, Any] | None = None,
        *,
        reselection: int | None = None,
    ) -> None:
        self.network = network
        extra = dict(environment or {})
        own = SICSettings(
            statistic, carry=extra.pop("carry", None), discount=extra.pop("discount", None)
        )
        self.needs = Needs(
            statistic=statistic,
            carry=own.carry,
            discount=own.discount,
            reselection=reselection,
            allow_idle=extra.pop("allow_idle", False),
            extra=extra,
        )

    def reset(self, mask: NDArray[np.bool_]) -> None:  # noqa: B027  (a default for all)
        """Nothing to forget: what it knows is in the observation and the infos."""

    @abstractmethod
    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Actions (N, A) from observations (N, D)."""

    def seen(self, observation: NDArray[np.float32]) -> torch.Tensor:
        """Observations (N, D) as the network takes them, λ within what it acts at."""
        if self.compute_weights is not None:
            observation = limit_compute_weight(observation, *self.compute_weights)
        return torch.from_numpy(observation)
