"""An environment that costs nothing, to see what Stable-Baselines3 costs by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn


class ConstantVecEnv(VecEnv):
    """Returns the same arrays at every step; no episode ends.

    Args:
        num_envs: N.
        observation_space: a flat box; the observation is zeros (N, D).
        action_space: any.
    """

    def __init__(
        self, num_envs: int, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
    ) -> None:
        """Make the constants."""
        self.render_mode = None
        super().__init__(num_envs, observation_space, action_space)
        self._observation = np.zeros((num_envs, *(observation_space.shape or ())), np.float32)
        self._rewards = np.zeros(num_envs, np.float32)
        self._done = np.zeros(num_envs, np.bool_)
        self._infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]

    def reset(self) -> np.ndarray:
        """Constants."""
        return self._observation

    def step_async(self, actions: np.ndarray) -> None:
        """Take no notice of the actions."""

    def step_wait(self) -> VecEnvStepReturn:
        """Constants."""
        return self._observation, self._rewards, self._done, self._infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute, once per environment."""
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set the attribute."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call the method, once for all."""
        return [getattr(self, method_name)(*method_args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        """No wrappers."""
        return [False] * self.num_envs
