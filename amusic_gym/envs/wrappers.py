"""Actions of one or several numbers in place of bits, with masks of those that are possible.

For algorithms that take no `MultiBinary`, such as DQN, and for those that read masks. Single:
`DiscreteSubsets` and `MultiDiscreteBits`; native vector: `VectorDiscreteSubsets` and
`VectorMultiDiscreteBits`, whose spaces are those of the single ones, batched.

The masks are in ``info["action_mask"]`` (int8, as the spaces' ``sample(mask)`` wants it) after
every reset and step, and ``action_masks()`` gives those of the present frame (bool, one row of a
route's values one after the other, as sb3-contrib's ``MaskablePPO`` wants it).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.sources import Banks, columns_for
from amusic_gym.envs.task import Task
from amusic_gym.utils.checks import number

MOST_TECHNIQUES = 10
"""Of which all subsets are numbered, 1023."""

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]

if TYPE_CHECKING:
    Wrapper = gym.Wrapper[Any, Any, Any, Any]
    Vector = VectorWrapper[Any, Any, Any, Any, Any]
else:
    Wrapper, Vector = gym.Wrapper, VectorWrapper


class _Recoded:
    """Steps with `bits` of an action, and infos with masks: stands before a wrapper's class."""

    env: Any
    action_space: Any
    single_action_space: Any

    def __init__(self, env: Any, **arguments: Any) -> None:
        RecordConstructorArgs.__init__(self, **arguments)  # type: ignore[arg-type]
        super().__init__(env)  # type: ignore[call-arg]
        task = getattr(env.unwrapped, "task", None)
        if not isinstance(task, Task):
            raise ValueError(f"{env} is no technique selection; wrap that environment")
        self._task = task
        space = self._space(task)
        if isinstance(env, VectorEnv):
            self.autoreset_mode = env.metadata.get("autoreset_mode")  # where TorchRL looks
            self.single_action_space = space
            space = batch_space(space, env.num_envs)
        self.action_space = space

    def _space(self, task: Task) -> spaces.Space[Any]:
        """The action space of one route."""
        raise NotImplementedError

    def bits(self, action: Any) -> NDArray[Any]:
        """The wrapped environment's action, (A,) or (N, A)."""
        raise NotImplementedError

    def _masks(self, present: Flags, seconds: Floats) -> Flags:
        """Possible values of an action, (N, ...), from (N, S) which techniques there are."""
        raise NotImplementedError

    def action_masks(self) -> Flags:
        """Possible values of the next action, (n,) or (N, n), n in all of each route's action."""
        slots = self._task.episodes.state.slots
        masks = self._masks(slots["present"] > 0, slots["seconds"])
        flat = masks.reshape(len(masks), -1)
        return flat if isinstance(self.env, VectorEnv) else flat[0]

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """As the wrapped environment's, with ``action_mask`` in the infos."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, self._with_masks(info)

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As the wrapped environment's, with ``action_mask`` in the infos.

        Raises:
            ValueError: for an action outside the space, or over the budget.
        """
        *result, info = self.env.step(self.bits(action))
        return *result, self._with_masks(info)

    def _with_masks(self, info: dict[str, Any]) -> dict[str, Any]:
        present = np.asarray(info["present"])
        masks = self._masks(np.atleast_2d(present), np.atleast_2d(info["run_seconds"]))
        masks &= present.any(-1).reshape(-1, *[1] * (masks.ndim - 1))  # else not begun, no info
        if present.ndim == 1:
            return {**info, "action_mask": masks[0].astype(np.int8)}
        info = {
            **info,
            "action_mask": masks.astype(np.int8),
            "_action_mask": info["_present"].copy(),
        }
        if "final_info" in info:
            info["final_info"] = self._with_masks(info["final_info"])
        return info


class _Subsets(_Recoded):
    """One number per subset of the techniques."""

    def __init__(self, env: Any, budget: float | None = None) -> None:
        if budget is not None and not 0.0 < number("budget", budget, "a number in (0, 1]") <= 1.0:
            raise ValueError(f"budget is {budget}; give a number in (0, 1]")
        self.budget = budget
        super().__init__(env, budget=budget)

    def _space(self, task: Task) -> spaces.Space[Any]:
        slots = task.slots
        if slots > MOST_TECHNIQUES:
            raise ValueError(
                f"{slots} techniques have {2**slots - 1} subsets; number those of at most"
                f" {MOST_TECHNIQUES}, or take MultiDiscreteBits"
            )
        if self.budget is not None and task.block:
            raise ValueError(
                "a re-selection runs what it needs, whatever the budget; leave out one of them"
            )
        first = 0 if task.episodes.allow_idle else 1
        numbers = np.arange(first, 2**slots)[:, None]
        self.subsets: Flags = (numbers >> np.arange(slots)) & 1 == 1
        """(A, T) the techniques of every action but re-select."""
        if self.budget is not None and (known := _known_costs(task)) is not None:
            self.subsets = self.subsets[self._fitting(*known).any(0)]
        bits = np.zeros((len(self.subsets) + bool(task.block), slots + bool(task.block)), np.int8)
        bits[: len(self.subsets), :slots] = self.subsets
        bits[len(self.subsets) :, -1] = 1
        self._bits = bits
        return spaces.Discrete(len(bits))

    def _fitting(self, present: Flags, seconds: Floats) -> Flags:
        """(N, A) which subsets lack no technique, and are within the budget."""
        lacking: Flags = (~present) @ self.subsets.T
        fitting: Flags = ~(lacking | self._dear(present, seconds))
        return fitting

    def _dear(self, present: Flags, seconds: Floats) -> Flags:
        """(N, A) which subsets are over the budget; the cheapest technique alone never is."""
        if self.budget is None:
            return np.zeros((len(present), len(self.subsets)), np.bool_)
        cheapest = np.where(present, seconds, np.inf).argmin(1)[:, None]
        alone = (self.subsets.sum(1) == 1) & (self.subsets.argmax(1) == cheapest)
        dear: Flags = (self._shares(seconds) > self.budget + 1e-9) & ~alone
        return dear

    def _shares(self, seconds: Floats) -> Floats:
        """(N, A) of the compute of all techniques."""
        shares: Floats = seconds @ self.subsets.T / np.maximum(seconds.sum(1), 1e-300)[:, None]
        return shares

    def _masks(self, present: Flags, seconds: Floats) -> Flags:
        masks = np.ones((len(present), len(self._bits)), np.bool_)
        masks[:, : len(self.subsets)] = self._fitting(present, seconds)
        return masks

    def bits(self, action: Any) -> NDArray[np.int8]:
        """The wrapped environment's action, (A,) or (N, A).

        Raises:
            ValueError: for an action outside the space, or over the budget.
        """
        given = np.asarray(action)
        most = len(self._bits)
        if given.shape != self.action_space.shape or not np.isin(given, np.arange(most)).all():
            raise ValueError(f"action {action!r}; give {self.action_space}")
        chosen = given.astype(np.int64)
        if self.budget is not None:
            self._refuse_dear(np.atleast_1d(chosen))
        return self._bits[chosen]

    def _refuse_dear(self, chosen: NDArray[np.int64]) -> None:
        slots = self._task.episodes.state.slots
        dear = self._dear(slots["present"] > 0, slots["seconds"])
        for i in np.flatnonzero(dear[np.arange(len(chosen)), chosen]):
            share = self._shares(slots["seconds"])[i, chosen[i]]
            raise ValueError(
                f"action {chosen[i]} costs {share:.0%} of all techniques, the budget is"
                f" {self.budget:.0%}; take one that action_masks() allows"
            )


def _known_costs(task: Task) -> tuple[Flags, Floats] | None:
    """(B, S) which techniques the banks hold, and their seconds; None where routes are drawn."""
    source = task.source
    if not isinstance(source, Banks) or not all(isinstance(b, ScoreBank) for b in source.banks):
        return None
    columns = np.array([columns_for(b, source.techniques, task.slots) for b in source.banks])
    costs = [b.seconds[c] for b, c in zip(source.banks, columns, strict=True)]
    return columns >= 0, np.where(columns >= 0, costs, 0.0)


class _Bits(_Recoded):
    """Each bit a number of two values."""

    def _space(self, task: Task) -> spaces.Space[Any]:
        return spaces.MultiDiscrete([2] * task.episodes.action_size)

    def _masks(self, present: Flags, seconds: Floats) -> Flags:
        masks = np.ones((len(present), self._task.episodes.action_size, 2), np.bool_)
        masks[:, : present.shape[1], 1] = present
        return masks

    def bits(self, action: Any) -> NDArray[Any]:
        """The wrapped environment's action: the same, which it checks itself."""
        return np.asarray(action)


class DiscreteSubsets(_Subsets, Wrapper, RecordConstructorArgs):
    """One number per subset of the T techniques, for a single environment.

    **Action space**: `Discrete(2^T − 1)`: action a runs technique t if bit t of a + 1 is set, so
    that 0 runs the first technique alone and 2^T − 2 all. With ``allow_idle`` it is
    `Discrete(2^T)`, and bit t of a counts: 0 runs nothing. With ``reselection`` there is one more
    action, the last: re-select. ``subsets`` (A, T) has the techniques of each.

    **Budget**: actions that cost more than this share of what all techniques cost are left out of
    the space where the costs are known when it is made: with given banks, those over the budget on
    all of them. Where costs differ between routes, as with simulated ones, the mask leaves out the
    others, and such an action is refused. The cheapest technique alone may always run.

    **Masks**: (A,). Subsets with techniques that the route lacks (``slots``) are left out, too;
    taken all the same they are what the others in them are.

    Args:
        env: a :class:`~amusic_gym.envs.env.TechniqueSelectionEnv`, in wrappers or not.
        budget: the largest share in (0, 1]; None: all subsets.

    Raises:
        ValueError: for another environment, a budget out of range or with ``reselection``, or more
            than `MOST_TECHNIQUES` techniques.
    """


class VectorDiscreteSubsets(_Subsets, Vector, RecordConstructorArgs):
    """As `DiscreteSubsets`, for a native vector environment.

    **Action space** of one route: that of `DiscreteSubsets`; of all: `MultiDiscrete([A] · N)`.
    Masks are (N, A).

    Args:
        env: a :class:`~amusic_gym.envs.vector_env.TechniqueSelectionVectorEnv`, in wrappers or not.
        budget: the largest share in (0, 1]; None: all subsets.

    Raises:
        ValueError: as `DiscreteSubsets`.
    """


class MultiDiscreteBits(_Bits, Wrapper, RecordConstructorArgs):
    """Every bit as a number of two values, for a single environment.

    **Action space**: `MultiDiscrete([2] · A)` in place of `MultiBinary(A)`: 1 runs the technique;
    with ``reselection`` the last one is re-select.

    **Masks**: (A, 2) in ``info["action_mask"]``, (2A,) by ``action_masks()``: 1 is left out for
    techniques that the route lacks (``slots``). ``tuple(info["action_mask"])`` is what ``sample``
    takes.

    Args:
        env: a :class:`~amusic_gym.envs.env.TechniqueSelectionEnv`, in wrappers or not.

    Raises:
        ValueError: for another environment.
    """


class VectorMultiDiscreteBits(_Bits, Vector, RecordConstructorArgs):
    """As `MultiDiscreteBits`, for a native vector environment.

    **Action space** of one route: `MultiDiscrete([2] · A)`; of all: `Box(0, 1, (N, A))` of whole
    numbers. Masks are (N, A, 2) in ``info["action_mask"]``, (N, 2A) by ``action_masks()``.

    Args:
        env: a :class:`~amusic_gym.envs.vector_env.TechniqueSelectionVectorEnv`, in wrappers or not.

    Raises:
        ValueError: for another environment.
    """
