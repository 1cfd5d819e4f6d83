"""Random subsets, the least a selector must beat."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import required
from amusic_gym.policies.protocol import Context, Needs
from amusic_gym.policies.registry import IDLE, RANDOM, RegisteredPolicy

FORM = "P[/idle]"


class Uniform:
    """Runs each technique with a fixed probability, independently per frame.

    Args:
        probabilities: (T,) or one number for all.
        seed: of the draws.
        idle: whether nothing runs where nothing was drawn, instead of the cheapest technique.
    """

    def __init__(
        self, probabilities: float | NDArray[np.float64], seed: int = 0, *, idle: bool = False
    ) -> None:
        self.needs = Needs(allow_idle=idle)
        self.probabilities = probabilities
        self._rng = np.random.default_rng(seed)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Nothing to forget."""

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Fresh draws for every route."""
        return self._rng.random(info["present"].shape) < self.probabilities


def uniform(argument: str | None, context: Context) -> Uniform:
    """``random:P`` or ``random:P/idle``: every technique with probability P.

    Where none is drawn the cheapest runs, or nothing with ``idle``.
    """
    text = required("random", argument, FORM)
    share, slash, word = text.partition("/")
    if slash and word != IDLE:
        raise ValueError(f"random:{text} is not of the form random:{FORM}; write it so")
    try:
        probability = float(share)
    except ValueError:
        probability = -1.0
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"random:{text}: {share!r} is no probability; give a number in [0, 1]")
    return Uniform(probability, context.seed, idle=bool(slash))


def _label(argument: str) -> str:
    return f"random, p = {argument.replace('/idle', ', may idle')}"


POLICY = RegisteredPolicy(
    "random",
    uniform,
    RANDOM,
    label_of=_label,
    colour="#999999",
    marker="v",
    draws=True,
    may_idle=True,
)
