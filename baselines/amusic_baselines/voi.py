"""Value of information: the subset whose p̂ on the next frame is worth most, after its cost."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import number
from amusic_baselines.costs import cost_shares
from amusic_gym.policies.protocol import Context, Needs
from amusic_gym.policies.registry import IDLE, VOI, RegisteredPolicy

KEEP = 0.9  # share of a technique's record that is left after each further run
LASTING = 0.99  # probability that what a record says still holds one frame later

FORM = "LAMBDA, voi:idle or voi:LAMBDA/idle"


@dataclass(eq=False)
class ValueOfInformation:
    """Runs the subset of the highest predicted p̂ − λ · compute share, searched greedily.

    Technique after technique joins, each time the one that raises that value most, until none
    raises it; the first joins in any case. Greedy as DIME, which takes the feature of the highest
    conditional mutual information per cost (Gadgil et al., 2024); the value of a subset less its
    cost is the objective of AACO (Valancius et al., 2024), which asks nearest neighbours where this
    rule asks running records.

    The predictor needs no ground truth. Each technique has a record: how probable it is that the
    technique's own place is right, as far as p̂ tells. On a frame on which it ran that is p̂ if its
    place agrees with the fused one, and min(p̂, 1 − p̂) if not: no more than p̂ leaves to other
    places, and no more than the frame itself was given. The record is a running mean over the
    technique's own runs. It starts at 1, so that every technique is worth trying while p̂ is in
    doubt. What it says may have changed since the last run: with probability 1 − ``lasting`` per
    frame it is as good as new, so that a technique which has not run for long is tried again.

    The p̂ of a subset is predicted as if its techniques were right or wrong independently: 1 minus
    the product of what each lacks of 1. Techniques that fail together make that too high; how good
    the rule can be is bounded by how good p̂ is. A technique is not tried where λ · its compute
    share exceeds all that is left of p̂ to gain.
    """

    compute_weight: float | None = None  # λ; None: the environment's
    _: KW_ONLY
    # whether nothing may run but on the first frame; predicted for that is the decay of p̂
    idle: bool = False
    keep: float = KEEP  # share of a record that is left after each further run, in [0, 1)
    lasting: float = LASTING  # probability that a record still holds one frame later, in (0, 1]

    def __post_init__(self) -> None:
        from amusic_gym.envs.observation import TECHNIQUE_FEATURES
        from amusic_gym.estimation.prediction import IDLE_DECAY  # these load Numba

        self.needs = Needs(allow_idle=self.idle)
        self._decay = IDLE_DECAY
        self._features, self._agrees = len(TECHNIQUE_FEATURES), TECHNIQUE_FEATURES.index("agrees")
        self._record = np.zeros((0, 0))  # (N, S)
        self._last = np.zeros((0, 0), np.int64)  # (N, S) frame of the last run, -1 before it
        self._fresh = np.zeros(0, np.bool_)  # (N,) routes that have just begun

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Forget the records of the routes of ``mask``."""
        if self._fresh.size != mask.size:
            self._fresh = np.ones(mask.size, np.bool_)
            self._record = np.zeros((mask.size, 0))
        self._fresh |= mask

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Actions (N, S): the subset of the highest predicted value on every route."""
        self._begin(info["present"])
        self._note(observation, info)
        weight = info["compute_weight"] if self.compute_weight is None else self.compute_weight
        price = np.reshape(weight, (-1, 1)) * cost_shares(info)
        actions, value = best_subset(self.promise(info["frame"]), price, info["present"])
        if self.idle:
            started = info["frame"] >= 0
            actions[started & (value <= self._decay * info["p_correct"])] = False
        return actions

    def promise(self, frame: NDArray[np.int64]) -> NDArray[np.float64]:
        """What each technique alone is predicted to give on the next frame, (N, S) in [0, 1].

        Args:
            frame: (N,) last frame of each route, -1 before the first.
        """
        age = np.maximum(frame[:, None] - self._last, 0)
        return 1.0 - (1.0 - self._record) * self.lasting**age

    def _begin(self, present: NDArray[np.bool_]) -> None:
        """Start the records of routes that have just begun."""
        if self._record.shape != present.shape:
            self._record = np.ones(present.shape)
            self._last = np.full(present.shape, -1)
        self._record[self._fresh] = 1.0
        self._last[self._fresh] = -1
        self._fresh[:] = False

    def _note(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> None:
        routes, slots = info["present"].shape
        groups = observation[:, : slots * self._features].reshape(routes, slots, -1)
        estimate = info["p_correct"][:, None]
        agrees = groups[..., self._agrees] > 0.5
        given = np.where(agrees, estimate, np.minimum(estimate, 1.0 - estimate))
        ran = info["ran"]
        self._record[ran] += (1.0 - self.keep) * (given - self._record)[ran]
        self._last = np.where(ran, info["frame"][:, None], self._last)


def best_subset(
    promise: NDArray[np.float64], price: NDArray[np.float64], present: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Greedy search for the subset of the highest predicted p̂ − price; ties: the lower index.

    Args:
        promise: (N, S) what each technique alone is predicted to give.
        price: (N, S) λ · compute share.
        present: (N, S), one at least on every route.

    Returns:
        The subsets (N, S), none of them empty, and their values (N,).
    """
    subset = np.zeros(present.shape, np.bool_)
    lacking, paid = np.ones(len(present)), np.zeros(len(present))
    routes = np.arange(len(present))
    for size in range(present.shape[1]):
        gains = np.where(present & ~subset, lacking[:, None] * promise - price, -np.inf)
        best = gains.argmax(axis=1)
        joins = np.isfinite(gains[routes, best]) & ((gains[routes, best] > 0.0) | (size == 0))
        subset[routes[joins], best[joins]] = True
        paid += np.where(joins, price[routes, best], 0.0)
        lacking = np.where(joins, lacking * (1.0 - promise[routes, best]), lacking)
    return subset, 1.0 - lacking - paid


def voi(argument: str | None, context: Context) -> ValueOfInformation:
    """``voi``, ``voi:LAMBDA``, ``voi:idle`` or ``voi:LAMBDA/idle``.

    Without LAMBDA, λ is the environment's; with ``idle``, nothing may run.
    """
    if argument is None or argument == IDLE:
        return ValueOfInformation(idle=argument == IDLE)
    weight, slash, word = argument.partition("/")
    if slash and word != IDLE:
        raise ValueError(f"voi:{argument} is not of the form voi:{FORM}; write it so")
    return ValueOfInformation(number("voi", argument, "LAMBDA", weight, 0.0), idle=bool(slash))


LABEL = "value of information"


def _label(argument: str) -> str:
    """For a reader: "0.15/idle" -> "value of information, fixed λ 0.15, may idle"."""
    parts = ("may idle" if part == IDLE else f"fixed λ {part}" for part in argument.split("/"))
    return ", ".join([LABEL, *parts])


POLICY = RegisteredPolicy(
    "voi",
    voi,
    VOI,
    LABEL,
    label_of=_label,
    colour="#005A32",
    marker="D",
    may_idle=True,
    reads_weight=lambda argument: argument in ("", IDLE),
)
