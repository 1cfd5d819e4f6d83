"""Which techniques are cheap, from what the infos say."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def cost_ranks(info: Mapping[str, Any]) -> NDArray[np.intp]:
    """Place (N, S) of every technique by cost on its route: 0 = cheapest; absent ones last.

    Among equally dear ones the lower index comes first, as where the environment takes the
    cheapest.
    """
    seconds = np.where(info["present"], info["run_seconds"], np.inf)
    return np.argsort(np.argsort(seconds, axis=1, kind="stable"), axis=1)


def cheapest(info: Mapping[str, Any]) -> NDArray[np.bool_]:
    """The cheapest technique of every route alone, (N, S)."""
    return (cost_ranks(info) == 0) & info["present"]


def cost_shares(info: Mapping[str, Any]) -> NDArray[np.float64]:
    """Cost (N, S) of one run as a share of running all techniques present; 0 for absent ones."""
    seconds = np.where(info["present"], info["run_seconds"], 0.0)
    return seconds / seconds.sum(axis=1, keepdims=True)
