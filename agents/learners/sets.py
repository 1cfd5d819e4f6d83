"""The encoder of the other algorithms' networks: techniques as a set, of any size and order."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from agents.network import ROUTE_WIDTH, WIDEST, WIDTH
from amusic_gym.observation import TECHNIQUE_FEATURES

PRESENT = TECHNIQUE_FEATURES.index("present")


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
            if not isinstance(size, int) or not 1 <= size <= WIDEST:
                raise ValueError(f"{name} is {size!r}; give a whole number from 1 to {WIDEST}")


def presence(observation: torch.Tensor) -> torch.Tensor:
    """(B, S) bool, which slots hold a technique, from observations (B, D)."""
    return observation[:, :-ROUTE_WIDTH][:, PRESENT::WIDTH] > 0.5


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
