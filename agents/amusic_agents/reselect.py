"""A selector that decides only *when* to select again: future work of A-MuSIC (its conclusions).

What is selected is the paper's rule (III-C1), through the environment's re-select bit; the learned
decision, at every frame, takes the place of its t-test. As in the paper, all techniques run for the
first M frames, then comes a selection; the selected techniques run until the next.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from amusic_agents.config import WIDEST, SetSizes, count
from amusic_agents.network import NetworkSelector, SetEncoder
from amusic_gym.estimation.settings import BLOCK

FIRST_LOGIT = -3.5  # of selecting again, untrained: once in 34 frames, for a selection is dear
GOLDEN_RATIO = (math.sqrt(5.0) - 1.0) / 2.0  # the fractions of its multiples fill [0, 1) evenly


@dataclass(frozen=True)
class ReselectSizes(SetSizes):
    """Sizes of the network; ``block``: M, the frames that a selection looks at."""

    block: int = count(BLOCK, most=WIDEST)


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
    """Logits (B, 2) of going on and of selecting again, from observations (B, D)."""

    def __init__(self, sizes: ReselectSizes) -> None:
        super().__init__()
        self.sizes = sizes
        layers = SetEncoder(sizes)
        self.encoder = nn.ModuleDict({"layers": layers})  # as stored weights name them
        self.latent_dim_vf = sizes.hidden  # V
        self.hidden = nn.Sequential(nn.Linear(layers.pooled, sizes.hidden), nn.Tanh())
        self.last = nn.Linear(sizes.hidden, 1)
        self.critic = nn.Sequential(nn.Linear(layers.pooled, sizes.hidden), nn.Tanh())
        nn.init.orthogonal_(self.last.weight, 0.01)
        nn.init.constant_(self.last.bias, FIRST_LOGIT)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """(B,) logits of selecting again."""
        return self.last(self.hidden(self.encoder["layers"](observation)[1])).squeeze(1)

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (B, 2), and the critic's features (B, V)."""
        return self.forward_actor(observation), self.forward_critic(observation)

    def forward_actor(self, observation: torch.Tensor) -> torch.Tensor:
        """Logits (B, 2)."""
        logits = self.logits(observation)
        return torch.stack([torch.zeros_like(logits), logits], dim=1)

    def forward_critic(self, observation: torch.Tensor) -> torch.Tensor:
        """The critic's features (B, V)."""
        return self.critic(self.encoder["layers"](observation)[1])


class ReselectSelector(NetworkSelector):
    """Keeps the selected techniques and selects again at the network's rate.

    What is learned is a rate: in trouble perhaps once in ten frames, else hardly ever. Taking the
    likelier value of the bit, as other selectors do, would never select again. So the chance is
    compared with numbers that spread evenly over [0, 1), the same on every route. Nothing is
    forgotten at a reset: the infos say where a route has just begun.
    """

    kind = "reselect"
    sizes_type = ReselectSizes
    network_type = ReselectNetwork

    def __init__(
        self, network: ReselectNetwork, statistic: str, environment: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(network, statistic, environment, reselection=network.sizes.block)
        self._held = HeldSelection(network.sizes.block)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The selected techniques and the re-select bit, (N, S + 1)."""
        self._held.note(info)
        with torch.inference_mode():
            chance = torch.sigmoid(self.network.logits(self.seen(observation))).numpy()
        return self._held.actions(chance > (info["frame"] + 1) * GOLDEN_RATIO % 1.0)
