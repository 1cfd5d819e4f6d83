"""A network that rates whole subsets of techniques, and the selector that runs the best one.

The rating of a subset depends on the sum of its techniques' encodings, so that it does not depend
on their order, and the same weights serve any number of techniques.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from amusic_agents.config import WIDEST, SetSizes, count
from amusic_agents.network import ROUTE_WIDTH, NetworkSelector, SetEncoder, presence
from amusic_gym.envs.observation import ROUTE_FEATURES
from amusic_gym.estimation.settings import COMPUTE_WEIGHT_RANGE

WEIGHT = ROUTE_FEATURES.index("compute_weight")
MOST_SLOTS = 10  # techniques of which all subsets are rated, 1024; each technique more doubles them


@lru_cache
def members(slots: int) -> torch.Tensor:
    """(A, S) bool, the techniques of every subset that is rated; the first one is empty.

    Of up to `MOST_SLOTS` techniques these are all 2^S: subset a holds technique t if bit t of the
    number a is set. Of more, they are those of at most two techniques.
    """
    if slots <= MOST_SLOTS:
        numbers = torch.arange(2**slots).unsqueeze(1)
        return (numbers >> torch.arange(slots)) & 1 == 1
    pairs = torch.combinations(torch.arange(slots), with_replacement=True)
    subsets = torch.zeros(1 + len(pairs), slots, dtype=torch.bool)
    return subsets.index_put(
        (torch.arange(1, 1 + len(pairs)).unsqueeze(1), pairs), torch.tensor(True)
    )


def valid(present: torch.Tensor, idle: bool = False) -> torch.Tensor:
    """(B, A) which subsets may run, from (B, S): nothing that is absent; the empty one if ``idle``.

    Where idling is not allowed, the environment would run the cheapest technique instead of it.
    """
    member = members(present.shape[1])
    absent = (~present).float() @ member.float().T  # (B, A) absent members of each
    allowed = absent < 0.5
    allowed[:, 0] = idle
    return allowed


@dataclass(frozen=True)
class SubsetSizes(SetSizes):
    """Sizes of the network."""

    ensemble: int = count(4, most=WIDEST)  # networks whose values are averaged


class SubsetValues(nn.Module):
    """Expected correctness and compute (B, A, 2) of subsets from observations (B, D)."""

    def __init__(self, sizes: SetSizes) -> None:
        super().__init__()
        layers = SetEncoder(sizes)
        self.encoder = nn.ModuleDict({"layers": layers})  # as stored weights name them
        self.member = nn.Linear(sizes.encoding, sizes.hidden, bias=False)
        self.whole = nn.Linear(layers.pooled, sizes.hidden)
        self.value = nn.Linear(sizes.hidden, 2)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, A, 2); absent members count nothing."""
        codes, pool = self.encoder["layers"](observation)
        member = members(codes.shape[1]).float()  # (A, S)
        sums = torch.einsum("as,bsh->bah", member, self.member(codes))  # (B, A, H)
        return self.value(torch.relu(sums + self.whole(pool).unsqueeze(1)))


class SubsetNetwork(nn.Module):
    """Ratings (B, A) of subsets from observations (B, D), by an ensemble.

    A rating is the correctness that is to be expected, less λ times the compute.
    """

    def __init__(self, sizes: SubsetSizes) -> None:
        super().__init__()
        self.sizes = sizes
        self.ensemble = nn.ModuleList(SubsetValues(sizes) for _ in range(sizes.ensemble))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, A) ratings."""
        correctness, compute = self.values(observation).mean(0).unbind(2)
        return correctness - compute_weight(observation).unsqueeze(1) * compute

    def values(self, observation: torch.Tensor) -> torch.Tensor:
        """(E, B, A, 2) expected correctness and compute of each subset, by each of the ensemble."""
        return torch.stack([values(observation) for values in self.ensemble])


def compute_weight(observation: torch.Tensor) -> torch.Tensor:
    """λ (B,) that observations (B, D) are of, within the range that they resolve."""
    low, high = COMPUTE_WEIGHT_RANGE
    place = 0.5 * (observation[:, WEIGHT - ROUTE_WIDTH] + 1.0)
    return low * (high / low) ** place


class SubsetSelector(NetworkSelector):
    """Runs the subset with the highest rating."""

    kind = "subsets"
    sizes_type = SubsetSizes
    network_type = SubsetNetwork

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The members of the best subset, (N, S)."""
        subsets, ratings = self._rated(observation)
        return subsets[ratings.argmax(1)].numpy()

    def rate(self, observation: NDArray[np.float32]) -> tuple[NDArray[np.bool_], NDArray[Any]]:
        """See `amusic_gym.policies.protocol.Rater`."""
        subsets, ratings = self._rated(observation)
        return subsets.numpy(), ratings[0].numpy()

    def _rated(self, observation: NDArray[np.float32]) -> tuple[torch.Tensor, torch.Tensor]:
        """Subsets (A, S) and their ratings (N, A), −∞ for those that cannot run."""
        seen = self.seen(observation)
        present = presence(seen)
        with torch.inference_mode():
            allowed = valid(present, self.needs.allow_idle)
            ratings = self.network(seen).masked_fill(~allowed, -torch.inf)
        return members(present.shape[1]), ratings
