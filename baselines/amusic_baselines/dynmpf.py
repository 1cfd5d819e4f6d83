"""Dyn-MPF-style: on every frame the subset of techniques whose fused row has the clearest peak.

After Hausler, Fischer, Milford: Unsupervised Complementary-aware Multi-process Fusion, 2021. All
techniques must run before a subset can be chosen. Our reading: every subset takes part, single
techniques too; of equally clear ones the smaller, then the one of lower technique indices.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import whole
from amusic_baselines.scores import RADIUS, rows_of, scaled
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy

MOST_TECHNIQUES = 10  # there are 2**T - 1 subsets, 1023 of so many


def subsets(techniques: int) -> NDArray[np.float64]:
    """(2**T - 1, T) of zeros and ones, the smaller subsets first."""
    sizes = range(1, techniques + 1)
    chosen = [list(c) for size in sizes for c in combinations(range(techniques), size)]
    table = np.zeros((len(chosen), techniques))
    for row, columns in zip(table, chosen, strict=True):
        row[columns] = 1.0
    return table


def clearness(
    fused: NDArray[np.float64], radius: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Peak of each row of (n, R) fused scores >= 0, and how clear it is.

    Clearness is 1 minus the next peak's share of it: as high as the ratio of the two is, but finite
    where nothing is left outside ±radius (1) or the row says nothing (0).
    """
    peak = fused.argmax(axis=1)  # (n,)
    height = fused[np.arange(len(fused)), peak]
    near = np.abs(np.arange(fused.shape[1]) - peak[:, None]) <= radius
    rival = np.where(near, 0.0, fused).max(axis=1)
    return peak, np.where(height > 0, 1.0 - rival / np.where(height > 0, height, 1.0), 0.0)


@dataclass(eq=False)
class DynamicFusion:
    """Runs everything and believes the subset with the clearest peak."""

    radius: int = RADIUS  # R, places to either side of a peak that belong to it

    def reset(self, references: int, techniques: int) -> None:
        """List the subsets."""
        self._subsets = subsets(techniques)

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """Peak of the chosen subset's summed scores, and its clearness."""
        rows = scaled(rows_of(run, range(self._subsets.shape[1])))
        peak, clear = clearness(self._subsets @ rows, self.radius)
        chosen = int(clear.argmax())
        return int(peak[chosen]), float(clear[chosen])


def dynmpf(argument: str | None, context: Context) -> DynamicFusion:
    """``dynmpf`` or ``dynmpf:R``."""
    if len(context.techniques) > MOST_TECHNIQUES:
        raise ValueError(
            f"dynmpf tries all subsets on every frame, too many of {len(context.techniques)} "
            f"techniques; give a bank of at most {MOST_TECHNIQUES}"
        )
    if argument is None:
        return DynamicFusion()
    return DynamicFusion(whole("dynmpf", argument, "R", argument, 0, 1_000_000))


POLICY = RegisteredPolicy(
    "dynmpf", dynmpf, PEER, "Dyn-MPF-style", colour="#AA3377", marker="p", constant=True
)
