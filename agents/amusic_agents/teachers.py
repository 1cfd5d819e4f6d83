"""Teachers of an imitation: one for every λ."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.policies.protocol import Needs, Selector


class ByWeight:
    """A selector that acts on every route as another one does, by the route's λ.

    All of them see all that happens, so that each may take over when a new route begins.

    Args:
        edges: λ between one selector and the next, rising; one fewer than there are selectors.
        selectors: for small to large λ; of the same needs.

    Raises:
        ValueError: for edges that do not rise or do not fit, or for different needs.
    """

    def __init__(self, edges: Sequence[float], selectors: Sequence[Selector]) -> None:
        self.edges = np.asarray(edges, np.float64)
        self.selectors = list(selectors)
        if self.edges.shape != (len(self.selectors) - 1,) or (np.diff(self.edges) <= 0.0).any():
            raise ValueError(
                f"edges are {list(edges)} for {len(self.selectors)} selectors; give one rising λ"
                " between each and the next"
            )
        if any(selector.needs != self.selectors[0].needs for selector in self.selectors):
            raise ValueError("the selectors need different environments; give those of one")

    @property
    def needs(self) -> Needs:
        """What all of them need."""
        return self.selectors[0].needs

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Forget the routes of ``mask``."""
        for selector in self.selectors:
            selector.reset(mask)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[Any]:
        """Actions (N, A), each of the selector for its route's λ."""
        which = np.searchsorted(self.edges, info["compute_weight"], side="right")  # (N,)
        actions = np.stack([selector.act(observation, info) for selector in self.selectors])
        return actions[which, np.arange(which.size)]


def partition(weights: tuple[float, float], parts: int) -> tuple[list[float], list[float]]:
    """Cut a range of λ into parts, even on a logarithmic scale.

    Returns:
        The edges between the parts, one fewer than parts, and the middle of each part.
    """
    points = np.geomspace(*weights, 2 * parts + 1)
    return points[2:-1:2].tolist(), points[1::2].tolist()
