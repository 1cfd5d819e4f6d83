"""Xu-style topological filter: a belief over places that a window of moves spreads on every frame.

Xu, Sünderhauf, Milford: Probabilistic Visual Place Recognition for Hierarchical Localization, RA-L
2020, and the program its authors published. Our reading where a route here differs from theirs:

 - They take distances √(2 − 2s) of unit descriptors; techniques here have scores of any scale, so
   the distance is the negative score. Several techniques: the product of their likelihoods.
 - A technique's rate λ = ln δ / (q97.5 − q2.5) is set on its first row that is not constant.
 - The place is the mean of the belief within one window's length of its peak, the confidence the
   mass there; their neighbourhood ends one place earlier at its upper end.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from amusic_baselines.arguments import number, technique_parts, whole
from amusic_baselines.scores import rows_of
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy

BACK, AHEAD = 2, 9  # places per frame, each move between as likely
DELTA = 5.0
MOST_DELTA = 1e9
QUANTILES = (0.025, 0.975)
FORM = "BACK/AHEAD/DELTA"
FARTHEST = 10_000


@dataclass(eq=False)
class TopologicalFilter:
    """Runs the same techniques on every frame; the place is the mean around the belief's peak."""

    columns: Sequence[int]  # indices of the techniques that run
    back: int = BACK  # most places backward per frame
    ahead: int = AHEAD  # most places forward per frame
    # likelihood of the best places over the worst, by the span of a technique's first row
    delta: float = DELTA

    def reset(self, references: int, techniques: int) -> None:
        """Know nothing of the place, nor of the spans of the scores."""
        self.moves = self.back + self.ahead + 1
        self._belief = np.full(references, 1.0 / references)  # (R,)
        self._rates = np.zeros((len(self.columns), 1))  # λ, of techniques with a row so far

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """The mean place around the belief's peak, and the mass there."""
        rows = rows_of(run, self.columns)  # (n, R)
        low, high = np.quantile(rows, QUANTILES, axis=1, keepdims=True)
        new = (self._rates == 0) & (high > low)
        self._rates[new] = math.log(self.delta) / (high - low)[new]
        evidence = (self._rates * (rows - rows.max(axis=1, keepdims=True))).sum(axis=0)  # (R,)
        before = self._belief
        if frame > 0:  # moves of one frame; what leaves the map is lost
            spread = np.convolve(before, np.ones(self.moves))
            before = spread[self.back : self.back + before.size]
        with np.errstate(divide="ignore"):  # of places that cannot be reached
            logs = np.log(before) + evidence
        belief = np.exp(logs - logs.max())
        self._belief = belief / belief.sum()
        peak = int(self._belief.argmax())
        first = max(0, peak - self.moves)
        near = self._belief[first : peak + self.moves + 1]
        mass = float(near.sum())
        return first + round(float(near @ np.arange(near.size)) / mass), mass


def xu(argument: str | None, context: Context) -> TopologicalFilter:
    """``xu``, ``xu:BACK/AHEAD/DELTA`` or ``xu:A+B/BACK/AHEAD/DELTA``; without names all run."""
    if argument is None:
        return TopologicalFilter(range(len(context.techniques)))
    columns, (back, ahead, delta) = technique_parts("xu", argument, FORM, context)
    return TopologicalFilter(
        columns,
        whole("xu", argument, "BACK", back, 0, FARTHEST),
        whole("xu", argument, "AHEAD", ahead, 0, FARTHEST),
        number("xu", argument, "DELTA", delta, 1.0, MOST_DELTA),
    )


POLICY = RegisteredPolicy(
    "xu", xu, PEER, "Xu-style filter", colour="#004488", marker="^", constant=True
)
