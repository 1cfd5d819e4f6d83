"""A network that rates whole subsets of techniques, for algorithms with one choice among 2^S.

The rating of a subset depends on the sum of its techniques' encodings, so that it does not depend
on their order, and the same weights serve any number of techniques.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn
from torch import nn

from agents.adapter import SB3VecEnv
from agents.learners import Kind
from agents.learners.driver import NetworkSelector
from agents.learners.sets import SetEncoder, SetSizes, presence
from agents.network import ROUTE_WIDTH
from amusic_gym.observation import ROUTE_FEATURES
from amusic_gym.settings import COMPUTE_WEIGHT_RANGE
from amusic_gym.vector_env import TechniqueSelectionVectorEnv

WEIGHT = ROUTE_FEATURES.index("compute_weight")

MOST_SLOTS = 10
"""1024 subsets; every technique more doubles what a step costs."""


@lru_cache
def members(slots: int) -> torch.Tensor:
    """(2^S, S) bool: subset a holds technique t if bit t of the number a is set.

    Raises:
        ValueError: for more than `MOST_SLOTS` techniques.
    """
    if slots > MOST_SLOTS:
        raise ValueError(
            f"{slots} techniques have 2^{slots} subsets, and this kind of selector rates every"
            f" one: give at most {MOST_SLOTS} techniques, or train one with --algorithm ppo"
        )
    numbers = torch.arange(2**slots).unsqueeze(1)
    return (numbers >> torch.arange(slots)) & 1 == 1


def valid(present: torch.Tensor) -> torch.Tensor:
    """(B, 2^S) which subsets may run, from (B, S): not the empty one, nothing that is absent."""
    member = members(present.shape[1])
    strange = (~present).float() @ member.float().T  # (B, 2^S) absent members of each
    allowed = strange < 0.5
    allowed[:, 0] = False  # the environment would run the cheapest technique
    return allowed


class SubsetNetwork(nn.Module):
    """Ratings (B, 2^S) of all subsets from observations (B, D); absent members count nothing.

    A rating is the correctness that is to be expected, less λ times the compute.

    Args:
        sizes: of the layers.
    """

    def __init__(self, sizes: SetSizes) -> None:
        super().__init__()
        self.encoder = SetEncoder(sizes)
        self.member = nn.Linear(sizes.encoding, sizes.hidden, bias=False)
        self.whole = nn.Linear(self.encoder.pooled, sizes.hidden)
        self.value = nn.Linear(sizes.hidden, 2)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, 2^S) ratings."""
        correctness, compute = self.values(observation).unbind(2)
        return correctness - compute_weight(observation).unsqueeze(1) * compute

    def values(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, 2^S, 2) expected correctness and compute of each subset."""
        codes, pool = self.encoder(observation)
        member = members(codes.shape[1]).float()  # (2^S, S)
        sums = torch.einsum("as,bsh->bah", member, self.member(codes))  # (B, 2^S, H)
        values: torch.Tensor = self.value(torch.relu(sums + self.whole(pool).unsqueeze(1)))
        return values


def compute_weight(observation: torch.Tensor) -> torch.Tensor:
    """λ (B,) that observations (B, D) are of, within the range that they resolve."""
    low, high = COMPUTE_WEIGHT_RANGE
    place = 0.5 * (observation[:, WEIGHT - ROUTE_WIDTH] + 1.0)
    weight: torch.Tensor = low * (high / low) ** place
    return weight


class SubsetSelector(NetworkSelector[SubsetNetwork]):
    """Runs the subset with the highest rating."""

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The members of the best subset, (N, S)."""
        seen = torch.from_numpy(observation)
        present = presence(seen)
        with torch.no_grad():
            ratings = self.network(seen).masked_fill(~valid(present), -torch.inf)
        return members(present.shape[1])[ratings.argmax(1)].numpy()


class SubsetVecEnv(SB3VecEnv):
    """The environment with one choice among all subsets, `Discrete(2^S)`.

    ``action_masks`` is what sb3-contrib asks for.
    """

    def __init__(self, env: TechniqueSelectionVectorEnv) -> None:
        super().__init__(env)
        self._members = members(env.task.slots).numpy()  # (2^S, S)
        self.action_space = spaces.Discrete(len(self._members))
        self._present = torch.ones(self.num_envs, env.task.slots, dtype=torch.bool)

    def reset(self) -> NDArray[np.float32]:
        """Begin an episode on every route."""
        return self._note(super().reset())

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take numbers of subsets (N,)."""
        super().step_async(self._members[actions])

    def step_wait(self) -> VecEnvStepReturn:
        """Step every route; ended ones begin anew."""
        observation, rewards, dones, infos = super().step_wait()
        assert isinstance(observation, np.ndarray)
        return self._note(observation), rewards, dones, infos

    def _note(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        self._present = presence(torch.from_numpy(observation))
        return observation

    def action_masks(self) -> list[NDArray[np.bool_]]:
        """For every route, which subsets may run, (2^S,)."""
        return list(valid(self._present).numpy())

    def has_attr(self, attr_name: str) -> bool:
        """Whether there is such an attribute, here or in the wrapped environment."""
        return attr_name == "action_masks" or super().has_attr(attr_name)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of the wrapped environment, or this one's ``action_masks``."""
        if method_name == "action_masks":
            return self.action_masks()
        return super().env_method(method_name, *method_args, indices=indices, **method_kwargs)


KIND = Kind("subsets", SetSizes, SubsetNetwork, SubsetSelector)
