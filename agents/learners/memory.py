"""A network that carries a memory (LSTM) from frame to frame, and the selector around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.learners import Kind
from agents.learners.driver import NetworkSelector
from agents.learners.sets import SetEncoder, SetSizes, presence
from agents.network import ABSENT

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


class RecurrentSelector(NetworkSelector[RecurrentNetwork]):
    """Runs the techniques that the network would rather run than not, with a memory per route."""

    def __init__(
        self,
        network: RecurrentNetwork,
        statistic: str,
        environment: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(network, statistic, environment)
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


KIND = Kind("recurrent", RecurrentSizes, RecurrentNetwork, RecurrentSelector)
