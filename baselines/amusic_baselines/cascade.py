"""Margin cascade: a cheap subset always, the dearer techniques while in doubt."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import number, parts, whole
from amusic_baselines.costs import cost_ranks
from amusic_gym.policies.protocol import Context, Needs
from amusic_gym.policies.registry import CASCADE, RegisteredPolicy
from amusic_gym.utils.names import suggest

CHEAP = 2
HOLD = 20
THRESHOLD = 0.5
FORM = "CHEAP/HOLD/THRESHOLD"

DOUBTS = {"p": "p_correct", "margin": "margin"}
"""What a threshold may be of -> its name in the environment's infos."""


@dataclass(eq=False)
class Cascade:
    """Runs the cheapest techniques, and all others for some frames after p̂ falls low.

    The hold is a hysteresis: a technique needs some frames in a row before SIC profits from it.
    """

    cheap: int = CHEAP  # how many techniques always run
    hold: int = HOLD  # frames for which the others run after a doubt
    threshold: float = THRESHOLD  # p̂, or margin, below which there is doubt
    doubt: str = DOUBTS["p"]  # or "margin", the fused statistic's lead over its best rival
    needs: ClassVar = Needs()
    # (N,) frames for which the dear ones still run
    _left: NDArray[np.int64] = field(init=False, default_factory=lambda: np.zeros(0, np.int64))

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Forget the doubts of the routes of ``mask``."""
        if self._left.size != mask.size:
            self._left = np.zeros(mask.size, np.int64)
        self._left[mask] = 0

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Cheap subset, and everything while in doubt."""
        doubt = (info[self.doubt] < self.threshold) & (info["frame"] >= 0)
        self._left = np.where(doubt, self.hold, np.maximum(self._left - 1, 0))
        return ((cost_ranks(info) < self.cheap) | (self._left > 0)[:, None]) & info["present"]


def cascade(argument: str | None, context: Context) -> Cascade:
    """``cascade`` or ``cascade:CHEAP/HOLD/THRESHOLD``; without, the cheapest two, 20 frames, 0.5.

    The threshold is of p̂; ``p=0.5`` says so, ``margin=2`` is one of the margin.
    """
    if argument is None:
        return Cascade()
    cheap, hold, threshold = parts("cascade", argument, FORM)
    kind, equals, value = threshold.rpartition("=")
    kind = kind if equals else "p"
    if kind not in DOUBTS:
        raise ValueError(f"cascade:{argument}: {suggest('kind of doubt', kind, DOUBTS)}")
    return Cascade(
        whole("cascade", argument, "CHEAP", cheap, 1, len(context.techniques)),
        whole("cascade", argument, "HOLD", hold, 1, 1_000_000),
        number("cascade", argument, "THRESHOLD", value, 0.0, *([1.0] if kind == "p" else [])),
        DOUBTS[kind],
    )


POLICY = RegisteredPolicy("cascade", cascade, CASCADE, colour="#6F4E37", marker="^")
