"""A subset on every Nth frame, and little or nothing between."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import columns, required, whole
from amusic_baselines.costs import cheapest
from amusic_gym.policies.protocol import Context, Needs
from amusic_gym.policies.registry import IDLE, PERIODIC, RegisteredPolicy

FORM = "N[/A+B[/C]]"
MOST = 1_000_000


class Periodic:
    """Runs one subset on frames 0, N, 2N, ... of a route and another on the frames between.

    Frames count from the beginning of the episode. On every Nth frame nothing but that subset runs.

    Args:
        period: N; 1: on every frame.
        columns: indices of the techniques on every Nth frame.
        between: indices of those on the other frames; none: nothing runs there; None: the cheapest.
    """

    def __init__(
        self, period: int, columns: Sequence[int], between: Sequence[int] | None = None
    ) -> None:
        self.period = period
        self.columns = list(columns)
        self.between = None if between is None else list(between)
        self.needs = Needs(allow_idle=self.between == [])

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Nothing to forget: the infos say which frame of its route each has seen."""

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Actions (N, S): one subset or the other, by the next frame of each route."""
        actions = np.zeros(info["present"].shape, np.bool_)
        if self.between is None:
            actions |= cheapest(info)
        else:
            actions[:, self.between] = True
        due = (info["frame"] + 1) % self.period == 0
        actions[due] = False
        actions[np.ix_(due, self.columns)] = True
        return actions


def periodic(argument: str | None, context: Context) -> Periodic:
    """``periodic:N``, ``periodic:N/A+B`` or ``periodic:N/A+B/C``.

    Without A+B all techniques on every Nth frame; without C the cheapest between; C is a subset or
    the word ``idle``: then nothing runs between.
    """
    text = required("periodic", argument, FORM)
    period, *subsets = text.split("/")
    if len(subsets) > 2:
        raise ValueError(f"periodic:{text} is not of the form periodic:{FORM}; write it so")
    every = whole("periodic", text, "N", period, 1, MOST)
    if not subsets:
        return Periodic(every, range(len(context.techniques)))
    chosen, *rest = (
        [] if at and names == IDLE else columns("periodic", text, names, context)
        for at, names in enumerate(subsets)
    )
    return Periodic(every, chosen, *rest)


def _label(argument: str) -> str:
    """For a reader: "5/HOG/idle" -> "HOG every 5 frames, else idle"."""
    period, *subsets = argument.split("/")
    often = "every frame" if period == "1" else f"every {period} frames"
    chosen, *between = subsets or ["all"]
    return ", else ".join([f"{chosen} {often}", *between])


POLICY = RegisteredPolicy(
    "periodic",
    periodic,
    PERIODIC,
    label_of=_label,
    colour="#E7298A",
    marker="o",
    constant=True,
    may_idle=True,
)
