"""The task under the single and the vector environment: spaces, routes, rewards, infos.

Both environments hold a :class:`Task`, the single one with a batch of one, so that there is one
implementation of everything but Gymnasium's two calling conventions.
"""

from __future__ import annotations

import copy
import inspect
import math
import operator
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from amusic_gym.envs.episode import Episodes
from amusic_gym.envs.live_route import ENDLESS
from amusic_gym.envs.memory import Route
from amusic_gym.envs.observation import bounds
from amusic_gym.envs.outcome import Outcome
from amusic_gym.envs.rewards import Reward, RewardInputs, Terms, as_reward
from amusic_gym.envs.sources import BankLike, Recording, RouteSource, as_source, columns_for
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.utils.checks import flag, number, whole
from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_gym.envs.pictures.viewer import Viewer

RESET_OPTIONS = ("bank", "start", "compute_weight")
RENDER_MODES = ("ansi", "rgb_array", "rgb_array_list", "human")
RENDER_FPS = 10
"""Frames per second of videos, and the most that the window of "human" shows."""


class Task:
    """Technique selection on a batch of N routes.

    Args:
        num_routes: N.
        bank: folder, :class:`~amusic_gym.banks.bank.ScoreBank`,
            :class:`~amusic_gym.envs.live_route.LiveRoute`, list of these, a
            :class:`~amusic_gym.envs.sources.RouteSource`, or None for simulated routes such as the
            statistic is made for.
        statistic: ``"belief"``, or SIC's ``"evidence"`` or ``"mean"``
            (:mod:`amusic_gym.estimation.settings`).
        candidates: K.
        history: F.
        gamma: weight of a row per frame of age.
        carry: whether places are carried on as candidates; None: with ``"evidence"``.
        discount: whether MuSIC discounts alike rows; None: with ``"evidence"``.
        compute_weight: λ, or a range from which every episode draws it on a logarithmic scale.
        reselection: M, the block of the re-select bit; None: no such bit.
        coverage: E of the re-selection.
        allow_idle: whether an empty action runs nothing.
        slots: S, to train ensembles of different size together; None: the banks' technique count.
        episode_length: frames after which an episode is truncated; None: never.
        random_start: whether episodes begin anywhere on the route.
        costs: cost model of given banks: ``"measured"``, ``"paper"`` or ``"runs"``.
        reward: ``"estimated"``, ``"ground_truth"`` or a callable (:mod:`amusic_gym.envs.rewards`).
        threads: of this process that step the routes with ``belief``, each a share of them. The
            results are the same for any number; more than one pay with many routes.
        render_mode: ``"ansi"`` (a line of text), ``"rgb_array"`` (a picture), ``"rgb_array_list"``
            (pictures of all steps), ``"human"`` (a window, which needs pygame) or None.
        unknown: arguments that an environment was given besides.

    Raises:
        TypeError: for an unknown argument, with the nearest suggested.
        ValueError: for any argument out of range, with the valid ones.
    """

    def __init__(
        self,
        num_routes: int,
        bank: BankLike | Sequence[BankLike] | RouteSource | None = None,
        *,
        statistic: str,
        candidates: int,
        history: int,
        gamma: float,
        carry: bool | None,
        discount: bool | None,
        compute_weight: float | tuple[float, float],
        reselection: int | None,
        coverage: float,
        allow_idle: bool,
        slots: int | None,
        episode_length: int | None,
        random_start: bool,
        costs: str,
        reward: str | Reward,
        threads: int,
        render_mode: str | None,
        unknown: Mapping[str, Any],
    ) -> None:
        for name in unknown:
            valid = [known for known in inspect.signature(Task).parameters if known != "unknown"]
            hint = suggest("environment argument", name, valid[1:])
            raise TypeError(f"unexpected keyword argument {name!r}: {hint}")
        num_routes = whole("num_envs", num_routes, 1)
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(suggest("render mode", render_mode, RENDER_MODES))
        self.settings = SICSettings(statistic, candidates, history, gamma, carry, discount)
        self.source = as_source(
            bank, costs=costs, aligned=slots is None, statistic=self.settings.statistic
        )
        self.slots = self._count("slots", slots, least=self.source.slots) or self.source.slots
        self.episode_length = self._count("episode_length", episode_length, least=1)
        self.last_frame = (self.episode_length or ENDLESS) - 1  # that an episode may have
        block = self._count("reselection", reselection, least=1) or 0
        if not 0.0 < number("coverage (E)", coverage, "a number in (0, 1]") <= 1.0:
            raise ValueError(f"coverage (E) is {coverage}; give a number in (0, 1]")
        self.random_start = flag("random_start", random_start)
        self.compute_weights = self._weight_range(compute_weight)
        self.reward = as_reward(reward)
        self.episodes = Episodes(
            num_routes,
            self.slots,
            self.settings,
            reselection=block,
            coverage=coverage,
            allow_idle=flag("allow_idle", allow_idle),
            threads=whole("threads", threads, 1),
        )
        self.block = block
        self.observation_space = spaces.Box(*bounds(self.slots), dtype=np.float32)
        self.action_space = spaces.MultiBinary(self.episodes.action_size)

    @staticmethod
    def _count(name: str, value: int | None, *, least: int) -> int | None:
        return None if value is None else whole(name, value, least, ", or None")

    @staticmethod
    def _weight_range(weight: Any) -> tuple[float, float]:
        wanted = "a number >= 0, or (low, high) with 0 < low <= high"
        ends = list(weight) if isinstance(weight, tuple | list) else [weight, weight]
        if len(ends) != 2:
            raise ValueError(f"compute_weight is {weight!r}; give {wanted}")
        low, high = (number("compute_weight", end, wanted) for end in ends)
        if not 0.0 <= low <= high or (low == 0.0 < high):
            raise ValueError(f"compute_weight is {weight!r}; give {wanted}")
        return low, high

    # --- episodes -------------------------------------------------------------------------------

    def begin(
        self, i: int, rng: np.random.Generator, options: Mapping[str, Any] | None = None
    ) -> None:
        """Begin an episode on route ``i``, drawn with its own generator.

        Args:
            i: number of the route in the batch.
            rng: the route's generator.
            options: any of ``bank`` (number in the list), ``start`` (query of the first frame)
                and ``compute_weight``, of this episode only.

        Raises:
            ValueError: for an unknown option or a value out of range.
        """
        given = self._options(options)
        bank, index = self.source.sample(rng, given.get("bank"))
        start = self._start(bank, rng, given.get("start"))
        weight = given.get("compute_weight")
        low, high = self.compute_weights if weight is None else self._weight_range(float(weight))
        if low < high:
            low = math.exp(rng.uniform(math.log(low), math.log(high)))
        columns = columns_for(bank, self.source.techniques, self.slots)
        frames = ENDLESS if bank.queries is None else bank.queries - start
        self.episodes.begin(i, Route(bank, start, frames, columns, low, index))

    def _start(self, bank: Recording, rng: np.random.Generator, start: int | None) -> int:
        """Query of the first frame: the one given, a drawn one, or the first."""
        if bank.queries is None:
            if start:
                raise ValueError(
                    f"start is {start}; {bank.name!r} does not know its length and begins at 0"
                )
            return 0
        if start is None:
            last = bank.queries - min(self.episode_length or 1, bank.queries)
            start = int(rng.integers(last + 1)) if self.random_start else 0
        if not 0 <= start < bank.queries:
            raise ValueError(f"start is {start}; bank {bank.name!r} has {bank.queries} queries")
        return start

    @staticmethod
    def _options(options: Mapping[str, Any] | None) -> dict[str, Any]:
        given: dict[str, Any] = {}
        for name, value in (options or {}).items():
            if name not in RESET_OPTIONS:
                raise ValueError(suggest("reset option", name, RESET_OPTIONS))
            if np.ndim(value):
                raise ValueError(
                    f"reset option {name} is {value!r}; give one number: one entry per route is for"
                    " the native vector environment, gymnasium.make_vec(...)"
                )
            try:
                given[name] = float(value) if name == "compute_weight" else operator.index(value)
            except (TypeError, ValueError):
                kind = "number" if name == "compute_weight" else "whole number"
                raise ValueError(f"reset option {name} is {value!r}; give a {kind}") from None
        return given

    # --- a step ---------------------------------------------------------------------------------

    def step(
        self, actions: NDArray[np.bool_], active: NDArray[np.bool_] | None = None
    ) -> tuple[Outcome, NDArray[np.float64], Terms]:
        """One frame of the active routes, or of all, and its reward.

        Returns:
            Outcome, rewards and their terms, all with leading N; 0 where no frame was processed.
        """
        out = self.episodes.step(actions, active)
        return out, *self.rewards(out)

    def ends(self, out: Outcome) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(N,) whether each route has terminated, and whether it was truncated."""
        routes = out.routes
        terminated = routes["ended"].copy()
        return terminated, (routes["frame"] >= self.last_frame) & ~terminated

    def rewards(self, out: Outcome) -> tuple[NDArray[np.float64], Terms]:
        """Rewards (N,) and their terms by name, each (N,); 0 where no frame was processed.

        Raises:
            ValueError: for a reward that gives none.
        """
        inputs = RewardInputs(out, out.routes["compute_weight"], partial(self.correct, out))
        given = self.reward(inputs)
        if not isinstance(given, Mapping) or not given:
            raise ValueError(
                f"the reward gave {given!r}; let it return named terms, for example {{'mine': ...}}"
            )
        terms = {name: self._per_route(term) for name, term in given.items()}
        active = self.episodes.state.active  # not those whose source has ended
        if not active.all():
            terms = {name: np.where(active, term, 0.0) for name, term in terms.items()}
        return sum(terms.values(), np.zeros(self.episodes.num_routes)), terms

    def _per_route(self, term: ArrayLike) -> NDArray[np.float64]:
        """A term as an array (N,) of its own."""
        values = np.array(term, np.float64)  # a copy
        shape = (self.episodes.num_routes,)
        return values if values.shape == shape else np.array(np.broadcast_to(values, shape))

    def correct(self, out: Outcome) -> NDArray[np.bool_]:
        """(N,) whether the predictions are true places."""
        correct = np.zeros(self.episodes.num_routes, np.bool_)
        places, frames = out.routes["prediction"].tolist(), out.routes["frame"].tolist()
        for i, route in enumerate(self.episodes.routes):
            if route is None or places[i] < 0:
                continue
            if route.bank.truth is None:
                raise ValueError(
                    f"live route {route.bank.name!r} has no ground truth, which the reward asks"
                    " for; give it ground_truth, or take reward='estimated'"
                )
            correct[i] = route.bank.truth.is_true(places[i], route.start + frames[i])
        return correct

    def repeated(self, copies: int) -> Task:
        """A task whose routes stand ``copies`` times in a row, each as it is now."""
        twin = copy.copy(self)
        twin.episodes = self.episodes.repeated(copies)
        return twin

    # --- pictures -------------------------------------------------------------------------------

    def render(self, mode: str | None, viewer: Viewer | None) -> tuple[Any, ...] | None:
        """What each route shows in a render mode; None for a mode that returns nothing."""
        if viewer is not None:
            return viewer.shown()
        routes = range(self.episodes.num_routes)
        return tuple(map(self.describe, routes)) if mode == "ansi" else None

    def describe(self, i: int) -> str:
        """One line on route ``i``, for ``render_mode="ansi"``."""
        route, record = self.episodes.routes[i], self.episodes.state.routes[i]
        if route is None:
            return "no route yet; call reset first"
        slots = self.episodes.state.slots[i]
        ran = [
            route.bank.techniques[t]
            for t, slot in zip(route.columns, slots, strict=True)
            if t >= 0 and slot["ran"]
        ]
        length = "" if record["frames"] == ENDLESS else f"/{record['frames']}"
        return (
            f"{route.bank.name} frame {record['frame'] + 1}{length}:"
            f" place {record['prediction']}, confidence {record['confidence']:.2f},"
            f" p {record['p_correct']:.2f}, ran {' + '.join(ran) or 'nothing'}"
        )


def as_seed(seed: int | None) -> int | None:
    """A seed that Gymnasium takes: Python's or NumPy's whole numbers from 0.

    Raises:
        ValueError: for anything else.
    """
    if seed is None:
        return None
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if number < 0:
        raise ValueError(f"seed is {seed!r}; give a whole number >= 0")
    return number
