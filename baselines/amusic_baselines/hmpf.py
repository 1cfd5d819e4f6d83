"""Hierarchical Multi-Process Fusion-style: tiers that pass their best candidates down.

After Hausler and Milford: Hierarchical Multi-Process Fusion for Visual Place Recognition, ICRA
2020. Which technique belongs to which tier was chosen by hand there. Ours: by rising cost, in
three tiers of equal size as far as possible (the earlier ones larger); with two techniques two
tiers, with one one. A later tier only had to match candidates there; here a run computes the whole
row, and that is what it costs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import none
from amusic_baselines.scores import rows_of, scaled, standardised
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy

CANDIDATES = (100, 10)  # that each technique of a tier passes on; the last tier decides
WEIGHTS = (0.5, 0.75, 1.0)  # of the tiers


def tiers_by_cost(seconds: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Technique indices of each tier, the cheapest techniques first."""
    order = np.argsort(seconds, kind="stable")
    return np.array_split(order, min(len(WEIGHTS), len(order)))


def fuse(rows: NDArray[np.float64], tiers: list[NDArray[np.int64]]) -> tuple[int, float]:
    """Place and confidence from the score rows (T, R) of one frame."""
    everywhere = candidates = np.arange(rows.shape[1])
    levels = []  # (R,) per tier; places that were not passed to it have 0
    for number, tier in enumerate(tiers):
        scores = np.zeros((len(tier), everywhere.size))
        scores[:, candidates] = scaled(rows[np.ix_(tier, candidates)])
        last = number == len(tiers) - 1
        levels.append(scores.mean(axis=0) if last else scores.max(axis=0))
        if not last:
            candidates = best_of_each(scores, candidates, CANDIDATES[number])
    weighted = [w * scaled(level[candidates]) for w, level in zip(WEIGHTS, levels, strict=False)]
    fused = standardised(np.sum(weighted, axis=0))
    winner = int(fused.argmax())
    return int(candidates[winner]), float(fused[winner])


def best_of_each(
    scores: NDArray[np.float64], candidates: NDArray[np.int64], count: int
) -> NDArray[np.int64]:
    """Union, in order of place, of the ``count`` best candidates of each row of (n, R) scores."""
    order = np.argsort(-scores[:, candidates], axis=1, kind="stable")[:, :count]
    return np.unique(candidates[order])


@dataclass(eq=False)
class HierarchicalFusion:
    """Runs everything; each tier of techniques looks at what the tier before passes on."""

    tiers: list[NDArray[np.int64]]  # technique indices of each, at most three

    def reset(self, references: int, techniques: int) -> None:
        """Nothing to forget but the number of techniques."""
        self._techniques = techniques

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """Best candidate by the weighted sum over tiers; its z-score among the candidates."""
        return fuse(rows_of(run, range(self._techniques)), self.tiers)


def hmpf(argument: str | None, context: Context) -> HierarchicalFusion:
    """``hmpf``: tiers by cost."""
    none("hmpf", argument)
    return HierarchicalFusion(tiers_by_cost(context.seconds))


POLICY = RegisteredPolicy(
    "hmpf", hmpf, PEER, "H-MPF-style", colour="#AA3377", marker=">", constant=True
)
