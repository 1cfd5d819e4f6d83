"""Borda voting: every technique ranks the places, the one with the most points wins.

Our reading: of a technique's ranking only the best `DEPTH` places get points, the first the most;
equal scores share their ranks, so that a constant row has no opinion. Ranking the whole map, as
Borda's count does, is `borda:DEPTH` with a DEPTH as long as the map: what is last and what is
second to last then counts as much as what is first. `DEPTH` was chosen on simulated routes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import whole
from amusic_baselines.scores import rows_of
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy

DEPTH = 20


def points(row: NDArray[np.float64], depth: int) -> NDArray[np.float64]:
    """Points of every place by (R,) scores: 1 for the first, 0 from the ``depth``-th on."""
    _, level, sizes = np.unique(-row, return_inverse=True, return_counts=True)
    rank = np.cumsum(sizes) - sizes + (sizes - 1) / 2.0  # mean rank of equal scores
    deepest = min(depth, row.size)
    return np.maximum(0.0, 1.0 - rank / deepest)[level]


@dataclass(eq=False)
class Borda:
    """Runs everything; each technique ranks the places."""

    depth: int = DEPTH  # places of each ranking that get points

    def reset(self, references: int, techniques: int) -> None:
        """Nothing to forget; T may be another."""
        self._techniques = techniques

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """The place with the most points, and their mean over the techniques."""
        rows = rows_of(run, range(self._techniques))
        total = np.mean([points(row, self.depth) for row in rows], axis=0)  # (R,)
        place = int(total.argmax())
        return place, float(total[place])


def borda(argument: str | None, context: Context) -> Borda:
    """``borda`` or ``borda:DEPTH``."""
    if argument is None:
        return Borda()
    return Borda(whole("borda", argument, "DEPTH", argument, 1, 1_000_000))


POLICY = RegisteredPolicy(
    "borda", borda, PEER, "Borda", colour="#6699CC", marker="H", constant=True
)
