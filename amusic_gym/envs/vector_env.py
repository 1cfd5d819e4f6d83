"""The native vector environment: N routes in one compiled loop, Gymnasium's ``VectorEnv``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from amusic_gym.envs.episode import as_actions
from amusic_gym.envs.outcome import (
    ROUTE_INFOS,
    SELECTION_INFOS,
    TECHNIQUE_INFOS,
    Infos,
    Outcome,
)
from amusic_gym.envs.pictures.viewer import Viewer, viewer_for
from amusic_gym.envs.registration import Specified
from amusic_gym.envs.rewards import Reward, Terms
from amusic_gym.envs.sources import BankLike, RouteSource
from amusic_gym.envs.task import RENDER_FPS, RENDER_MODES, Task, as_seed
from amusic_gym.estimation.settings import COVERAGE, SICSettings
from amusic_gym.utils.names import suggest

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
SPACES = ("observation_space", "action_space")


class TechniqueSelectionVectorEnv(
    Specified, VectorEnv[NDArray[np.float32], NDArray[np.int8], NDArray[Any]]
):
    """N routes at once; equal bit for bit to N single environments in a ``SyncVectorEnv``.

    Args:
        num_envs: N.
        bank: as in :class:`amusic_gym.envs.env.TechniqueSelectionEnv`.
        autoreset_mode: any of Gymnasium's modes.
        max_episode_steps: what ``gymnasium.make_vec`` passes; the same as ``episode_length``.
        statistic: this and all that follow: see :class:`amusic_gym.envs.task.Task`.

    Raises:
        TypeError: for an unknown argument, with the nearest suggested.
        ValueError: for any argument out of range, with the valid ones.
    """

    _viewer: Viewer | None = None  # closed even if the rest was never made

    def __init__(
        self,
        num_envs: int = 1,
        bank: BankLike | Sequence[BankLike] | RouteSource | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        statistic: str = SICSettings.statistic,
        candidates: int = SICSettings.candidates,
        history: int = SICSettings.history,
        gamma: float = SICSettings.gamma,
        carry: bool | None = SICSettings.carry,
        discount: bool | None = SICSettings.discount,
        compute_weight: float | tuple[float, float] = 1.0,
        reselection: int | None = None,
        coverage: float = COVERAGE,
        allow_idle: bool = False,
        slots: int | None = None,
        episode_length: int | None = None,
        random_start: bool = False,
        costs: str = "measured",
        reward: str | Reward = "estimated",
        threads: int = 1,
        render_mode: str | None = None,
        **unknown: Any,
    ) -> None:
        self.autoreset_mode = self._mode(autoreset_mode)
        if episode_length is None:
            episode_length = max_episode_steps
        self.task = Task(
            num_envs,
            bank,
            statistic=statistic,
            candidates=candidates,
            history=history,
            gamma=gamma,
            carry=carry,
            discount=discount,
            compute_weight=compute_weight,
            reselection=reselection,
            coverage=coverage,
            allow_idle=allow_idle,
            slots=slots,
            episode_length=episode_length,
            random_start=random_start,
            costs=costs,
            reward=reward,
            threads=threads,
            render_mode=render_mode,
            unknown=unknown,
        )
        self.num_envs = num_envs
        self.render_mode = render_mode
        self._viewer = viewer_for(self.task.episodes, render_mode, RENDER_FPS)
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": RENDER_FPS,
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space = self.task.observation_space
        self.single_action_space = self.task.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._action_shape = (num_envs, self.task.episodes.action_size)
        self._generators = [seeding.np_random() for _ in range(num_envs)]
        self._begun = np.zeros(num_envs, np.bool_)
        self._ended = np.zeros(num_envs, np.bool_)

    @staticmethod
    def _mode(mode: AutoresetMode | str) -> AutoresetMode:
        valid = {m.value: m for m in AutoresetMode}
        if isinstance(mode, AutoresetMode):
            return mode
        if mode not in valid:
            raise ValueError(suggest("autoreset mode", mode, tuple(valid)))
        return valid[mode]

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Infos]:
        """Begin an episode on every route, or on those of ``options["reset_mask"]``.

        Args:
            seed: route i is seeded with seed + i; or one seed per route.
            options: for these episodes only: those of the single environment, each a number or
                one entry per route, and ``reset_mask`` (N,) bool.

        Raises:
            ValueError: for other seeds, options or masks.
        """
        options = dict(options or {})
        mask = self._reset_mask(options.pop("reset_mask", None))
        for i, single in enumerate(self._seeds(seed)):
            if mask[i]:
                if single is not None:
                    self._generators[i] = seeding.np_random(single)
                self._begin(i, options)
        out = self.task.episodes.look()
        if self._viewer is not None:
            self._viewer.look()
        return out.observation, infos_of(out, self.task.rewards(out)[1], mask)

    def _begin(self, i: int, options: Mapping[str, Any] | None = None) -> None:
        given = {name: self._entry(name, value, i) for name, value in (options or {}).items()}
        self.task.begin(i, self._generators[i][0], given)
        self._begun[i], self._ended[i] = True, False

    def _entry(self, name: str, value: Any, i: int) -> Any:
        """A reset option's value for route ``i``."""
        if not np.ndim(value):
            return value
        if len(value) != self.num_envs:
            raise ValueError(
                f"reset option {name!r} has {len(value)} entries for {self.num_envs} routes; give"
                " one per route, or one for all"
            )
        return value[i]

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, list | tuple | np.ndarray):
            if len(seed) != self.num_envs:
                raise ValueError(f"{len(seed)} seeds for {self.num_envs} routes; give one each")
            return [as_seed(single) for single in seed]
        first = as_seed(seed)  # type: ignore[arg-type]
        assert first is not None
        return [first + i for i in range(self.num_envs)]

    def _reset_mask(self, mask: Flags | None) -> Flags:
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"reset_mask is {mask!r}; give ({self.num_envs},) booleans, at least one True"
            )
        return mask

    def step(self, actions: ArrayLike) -> tuple[NDArray[np.float32], Floats, Flags, Flags, Infos]:
        """Run the chosen techniques on every route's next frame.

        Raises:
            ResetNeeded: before the first reset, and with autoreset disabled after an end.
            ValueError: for actions outside the action space.
        """
        self._check_running()
        checked = as_actions(actions, self._action_shape)
        active = None
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and self._ended.any():
            active = ~self._ended
            for i in np.flatnonzero(self._ended):
                self._begin(int(i))
        out, rewards, terms = self.task.step(checked, active)
        terminated, truncated = self.task.ends(out)
        if active is not None:
            terminated, truncated = terminated & active, truncated & active
        self._ended = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._ended.any():
            out, infos = self._restart(out, terms)
        else:
            infos = infos_of(out, terms)
        if self._viewer is not None:
            self._viewer.look()
        return out.observation, rewards, terminated, truncated, infos

    def _check_running(self) -> None:
        if not self._begun.all():
            raise ResetNeeded("no episode is running; call reset() first")
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            ended = np.flatnonzero(self._ended).tolist()
            raise ResetNeeded(
                f"routes {ended} have ended; reset them with options={{'reset_mask': ...}}"
            )

    def _restart(self, last: Outcome, terms: Terms) -> tuple[Outcome, Infos]:
        """Begin new episodes where one has ended (SAME_STEP).

        Returns:
            The outcome with their start instead; infos with those of the steps that ended the
            others, and their last observations.
        """
        ended, out = self._ended.copy(), last.copy()
        for i in np.flatnonzero(ended):
            self._begin(int(i))
        out.take(self.task.episodes.look(), ended)
        infos = infos_of(out, {name: np.where(ended, 0.0, term) for name, term in terms.items()})
        final = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(ended):
            final[i] = last.observation[i]
        infos |= {
            "final_obs": final,
            "_final_obs": ended.copy(),
            "final_info": infos_of(last, terms, ended),
            "_final_info": ended,
        }
        return out, infos

    def render(self) -> tuple[Any, ...] | None:
        """What the single environment's ``render`` gives, for every route.

        The window of ``"human"`` shows the first routes side by side, as many as can be read.
        """
        return self.task.render(self.render_mode, self._viewer)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Generator of every route, as of ``SyncVectorEnv``."""
        return tuple(generator for generator, _ in self._generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of every route's generator."""
        return tuple(seed for _, seed in self._generators)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """An attribute of N single environments, or what calling it gives, as ``SyncVectorEnv``'s.

        Args:
            name: of an attribute that all routes share, of one of those that they have each
                (``np_random``, ``np_random_seed``, the spaces), or ``render``.
            args: for a method.
            kwargs: for a method.

        Raises:
            AttributeError: for another name, and for ``reset`` and ``step``.
        """
        if name in ("reset", "step"):
            raise AttributeError(f"routes are not called one by one; call {name}() of them all")
        value = getattr(self, {space: f"single_{space}" for space in SPACES}.get(name, name))
        value = value(*args, **kwargs) if callable(value) else value
        own = name in ("np_random", "np_random_seed") or (name == "render" and value is not None)
        return tuple(value) if own else (value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """As :meth:`call`, of an attribute."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute, which all routes share.

        Args:
            name: of the attribute.
            values: the value, or a list or tuple of N times the same one.

        Raises:
            ValueError: for values that differ.
        """
        if not isinstance(values, list | tuple):
            values = [values]
        elif len(values) != self.num_envs or any(value != values[0] for value in values):
            raise ValueError(f"{name} is {values!r}; give one value: the routes share it")
        setattr(self, name, values[0])

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one."""
        if self._viewer is not None:
            self._viewer.close()


def infos_of(out: Outcome, terms: Terms, mask: NDArray[np.bool_] | None = None) -> Infos:
    """Infos as Gymnasium's vector environments give them: name → array with leading N.

    Args:
        out: what the step gave.
        terms: of the reward.
        mask: (N,) routes that they are of; zero and unset outside. None: all.
    """
    if mask is not None and not mask.all():
        out = out.only(mask)
        terms = {name: np.where(mask, term, 0.0) for name, term in terms.items()}
    routes, slots = out.routes, out.slots
    infos: Infos = {name: routes[name].copy() for name in ROUTE_INFOS}
    for name in TECHNIQUE_INFOS:
        infos[name] = slots[name].copy()
    infos["reward_terms"] = _with_masks(dict(terms), mask, len(routes))
    if out.corrections.size:
        selection = {"happened": routes["happened"].copy(), "corrections": out.corrections}
        for name in SELECTION_INFOS:
            selection[name] = slots[name].copy()
        infos["selection"] = _with_masks(selection, mask, len(routes))
    return _with_masks(infos, mask, len(routes))


def _with_masks(infos: Infos, mask: NDArray[np.bool_] | None, routes: int) -> Infos:
    """Infos with a mask (N,) after each, an array of its own."""
    masks = np.empty((len(infos), routes), np.bool_)
    masks[:] = True if mask is None else mask
    result: Infos = {}
    for (name, value), its in zip(infos.items(), masks, strict=True):
        result[name], result["_" + name] = value, its
    return result
