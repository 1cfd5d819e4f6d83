"""The native vector environment as Stable-Baselines3 wants it."""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorWrapper
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

MASKS = "action_masks"  # the method of `envs.wrappers` that sb3-contrib asks for masks


class SB3VecEnv(VecEnv):
    """Wraps a vector environment with SAME_STEP autoreset; Stable-Baselines3 takes no other.

    The infos of ended episodes hold what Stable-Baselines3 reads (``terminal_observation``,
    ``TimeLimit.truncated``, ``episode``, and in this the means of the ``reward_terms``); those of
    other steps hold nothing, so that the hot path builds no dictionary for every route.

    Args:
        env: a :class:`~amusic_gym.envs.vector_env.TechniqueSelectionVectorEnv`, in Gymnasium's
            vector wrappers or not.
        infos: whether the infos of every step, and ``reset_infos``, hold all that the environment
            tells of a route, as single environments in a ``DummyVecEnv`` would.

    Raises:
        ValueError: for another autoreset mode.
    """

    def __init__(
        self, env: TechniqueSelectionVectorEnv | VectorWrapper, infos: bool = False
    ) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"{type(env).__name__} with autoreset mode {getattr(mode, 'value', mode)!r}:"
                f" Stable-Baselines3 needs gymnasium.make_vec(..., autoreset_mode='SameStep')"
            )
        self.env: Any = env
        self.render_mode = env.render_mode
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = env.metadata
        self.infos = infos
        self._actions: NDArray[Any] = np.zeros(0)
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, np.int64)
        self._terms: dict[str, NDArray[np.float64]] = {}
        self._begun = time.monotonic()

    def reset(self) -> NDArray[np.float32]:
        """Begin an episode on every route, with the seeds and options set before."""
        seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
        options = self._merged_options()
        observation, info = self.env.reset(seed=seeds, options=options)
        if self.infos:
            self.reset_infos = [_of_route(info, i) for i in range(self.num_envs)]
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self._terms.clear()
        self._reset_seeds()
        self._reset_options()
        return observation

    def _merged_options(self) -> dict[str, Any] | None:
        """One entry per route of every option that all routes have."""
        if not any(self._options):
            return None
        names = set(self._options[0])
        if any(set(options) != names for options in self._options):
            raise ValueError("options must name the same things for every route")
        return {name: np.array([o[name] for o in self._options]) for name in names}

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step every route; ended ones begin anew."""
        observation, rewards, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [
            _of_route(info, i) if self.infos else {} for i in range(self.num_envs)
        ]
        terms = info["final_info"]["reward_terms"] if done.any() else info["reward_terms"]
        self._sum_terms(terms, info["reward_terms"], done)
        for i in np.flatnonzero(done).tolist():
            ended = self._ended(i, info["final_obs"][i], bool(truncated[i]))
            if self.infos:
                self.reset_infos[i] = infos[i]
                ended = {**_of_route(info["final_info"], i), **ended}
            infos[i] = ended
        return observation, rewards.astype(np.float32), done, infos

    def _sum_terms(self, final: dict[str, Any], running: dict[str, Any], done: Any) -> None:
        for name, values in running.items():
            if not name.startswith("_"):
                total = self._terms.setdefault(name, np.zeros(self.num_envs))
                total += np.where(done, final[name], values)

    def _ended(self, i: int, final: NDArray[np.float32], truncated: bool) -> dict[str, Any]:
        length = int(self._lengths[i])
        ended = {
            "terminal_observation": final,
            "TimeLimit.truncated": truncated,
            "episode": {
                "r": float(self._returns[i]),
                "l": length,
                "t": time.monotonic() - self._begun,
                "reward_terms": {n: float(v[i]) / length for n, v in self._terms.items()},
            },
        }
        self._returns[i] = 0.0
        self._lengths[i] = 0
        for values in self._terms.values():
            values[i] = 0.0
        return ended

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of every route, with ``render_mode="rgb_array"``."""
        pictures = self.env.render()
        return [None] * self.num_envs if pictures is None else list(pictures)

    def close(self) -> None:
        """Close the wrapped environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the wrapped environment, once per route."""
        return self._per_route(getattr(self._owner(attr_name), attr_name), indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the wrapped environment, which all routes share."""
        setattr(self._owner(attr_name), attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of the wrapped environment once; masks are split between the routes."""
        result = getattr(self._owner(method_name), method_name)(*method_args, **method_kwargs)
        if method_name == MASKS:
            return [result[i] for i in self._get_indices(indices)]
        return self._per_route(result, indices)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Whether a vector wrapper is of that class; of ``Monitor``: yes, it tells of episodes."""
        own = wrapper_class is Monitor or any(isinstance(e, wrapper_class) for e in self._layers())
        return self._per_route(own, indices)

    def _layers(self) -> Iterator[Any]:
        """The environment in its wrappers, from outside in."""
        layer: Any = self.env
        while isinstance(layer, VectorWrapper):
            yield layer
            layer = layer.env
        yield layer

    def _owner(self, name: str) -> Any:
        """The outermost layer that has an attribute; else the environment itself."""
        return next((e for e in self._layers() if hasattr(e, name)), self.env.unwrapped)

    def _per_route(self, value: Any, indices: VecEnvIndices) -> list[Any]:
        return [value] * len(list(self._get_indices(indices)))


def _of_route(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """What a single environment would tell, from the infos of a vector environment."""
    own: dict[str, Any] = {}
    for name, values in infos.items():
        if name.startswith(("_", "final_")):
            continue
        if isinstance(values, dict):
            own[name] = _of_route(values, i)
        else:
            own[name] = values[i].copy() if np.ndim(values) > 1 else values[i].item()
    return own
