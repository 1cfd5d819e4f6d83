"""Fixed subsets: one technique, several, or all of them (MuSIC, III-B)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import columns, none, required
from amusic_gym.policies.protocol import Context, Needs
from amusic_gym.policies.registry import FIXED, RegisteredPolicy


class Subset:
    """Runs the same techniques, whose indices are ``columns``, on every frame."""

    needs = Needs()

    def __init__(self, columns: Sequence[int]) -> None:
        self.columns = list(columns)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Nothing to forget."""

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The same bits for every route."""
        actions = np.zeros(info["present"].shape, np.bool_)
        actions[:, self.columns] = True
        return actions


def single(argument: str | None, context: Context) -> Subset:
    """``single:NAME``: one technique, corrected by SIC."""
    return Subset([context.index(required("single", argument, "NAME"))])


def subset(argument: str | None, context: Context) -> Subset:
    """``subset:A+B``: MuSIC over some techniques."""
    text = required("subset", argument, "A+B")
    return Subset(columns("subset", text, text, context))


def music(argument: str | None, context: Context) -> Subset:
    """``music``: MuSIC over all techniques."""
    none("music", argument)
    return Subset(range(len(context.techniques)))


SINGLE = RegisteredPolicy("single", single, FIXED, label_of=str, colour=None, constant=True)
SUBSET = RegisteredPolicy(
    "subset", subset, FIXED, label_of=str, colour=None, line="--", constant=True
)
MUSIC = RegisteredPolicy(
    "music", music, FIXED, "MuSIC", colour="#000000", marker="s", constant=True
)
