"""SwitchHit-style: one technique after the other, until one is probably right.

After Waheed, Milford, McDonald-Maier, Ehsan: SwitchHit, 2022 (arXiv 2203.00591). It needs ground
truth beforehand: labelled routes tell how likely a technique is right given its best score, and
which technique is right where another is wrong. Our reading:

 - The score is the z-score of a row's best place: raw scores of different maps differ in range.
 - The first technique is the cheapest.
 - `Experience.of` learns from labelled routes with the same techniques, as the paper does.
   ``switchhit`` has no such routes: it learns from simulated ones, whose techniques are others. So
   one curve of correctness serves all techniques, and in the table of who helps whom a technique
   is known by its rank in cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import number
from amusic_baselines.scores import standardised
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy

THRESHOLD = 0.7  # τ: correctness at which it stops
ROUTES = 48  # simulated routes to learn from, by the seeds 0, 1, ...
FRAMES = 100  # of each
GRID = 128  # scores at which the densities are evaluated
LEAST_WIDTH = 0.05  # of a density's kernel, in standard deviations of a row
UNSEEN = 1e-9  # density below which a score counts as never seen


@dataclass(frozen=True)
class Experience:
    """What labelled routes say about T techniques."""

    score: NDArray[np.float64]  # (G,) rising z-scores of a row's best place
    p_right: NDArray[np.float64]  # (T, G) chance that a technique is right, given such a score
    # (T, T) share of the frames where technique i is wrong on which technique j is right
    helps: NDArray[np.float64]

    @classmethod
    def of(cls, banks: Sequence[ScoreBank], *, pooled: bool = False) -> Experience:
        """Learn from labelled routes with the same techniques in the same order.

        ``pooled`` gives one curve for all techniques instead of one for each.

        Raises:
            ValueError: for no bank, or different techniques.
        """
        names = list(dict.fromkeys(bank.techniques for bank in banks))
        if len(names) != 1:
            told = " and ".join(", ".join(n) for n in names) or "no route at all"
            raise ValueError(
                f"SwitchHit learns from labelled routes with the same techniques, got {told}; "
                "give some with those of the route it is to run on, in the same order"
            )
        best, right = _observe(banks)
        grid = np.linspace(best.min(), best.max(), GRID)
        groups = (
            [(best.ravel(), right.ravel())] * len(best) if pooled else zip(best, right, strict=True)
        )
        curves = [_p_right(grid, scores, hits) for scores, hits in groups]
        wrong = ~right
        together = wrong.astype(np.float64) @ right.T.astype(np.float64)  # (T, T) frames
        return cls(grid, np.stack(curves), together / np.maximum(wrong.sum(axis=1), 1)[:, None])

    def correctness(self, technique: int, score: float) -> float:
        """Chance that a technique with that best z-score is right; beyond the grid, its end."""
        return float(np.interp(score, self.score, self.p_right[technique]))

    def arranged(self, order: NDArray[np.int64]) -> Experience:
        """The same for techniques of which number i is this one's number ``order[i]``."""
        return replace(self, p_right=self.p_right[order], helps=self.helps[np.ix_(order, order)])


def _observe(banks: Sequence[ScoreBank]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(T, N) best z-score and whether the best place is right, over the frames of all banks."""
    best, right = [], []
    for bank in banks:
        shape = len(bank.techniques), bank.queries
        sure, place = np.zeros(shape), np.zeros(shape, np.int64)
        for at in np.ndindex(*shape):  # row by row: a large bank does not fit into memory
            z = standardised(np.asarray(bank.row(*at), np.float64))
            place[at] = z.argmax()
            sure[at] = z[place[at]]
        best.append(sure)
        right.append(np.stack([bank.truth.correct(p, np.arange(bank.queries)) for p in place]))
    return np.concatenate(best, axis=1), np.concatenate(right, axis=1)


def _p_right(
    grid: NDArray[np.float64], scores: NDArray[np.float64], right: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Bayes' rule on the densities of right and wrong scores; where none was seen, the prior."""
    prior = float(right.mean())
    for_it = prior * _density(grid, scores[right])
    against = (1.0 - prior) * _density(grid, scores[~right])
    seen = for_it + against
    return np.where(seen > UNSEEN, for_it / np.where(seen > UNSEEN, seen, 1.0), prior)


def _density(grid: NDArray[np.float64], sample: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gaussian kernel density of a sample at the grid, Silverman's width; of nothing, 0."""
    if not sample.size:
        return np.zeros_like(grid)
    width = max(LEAST_WIDTH, 1.06 * float(sample.std()) * sample.size**-0.2)
    kernels = [np.exp(-0.5 * ((at - sample) / width) ** 2).mean() for at in grid]
    return np.array(kernels) / (width * np.sqrt(2.0 * np.pi))


@lru_cache(maxsize=8)
def simulated(techniques: int) -> Experience:
    """Experience from simulated routes with T techniques, in order of rising cost."""
    from amusic_gym.routes.simulate import TECHNIQUE_NAMES, simulate

    if techniques > len(TECHNIQUE_NAMES):
        raise ValueError(
            f"switchhit learns from simulated routes of at most {len(TECHNIQUE_NAMES)} techniques, "
            f"not {techniques}; give a bank with fewer"
        )
    names = TECHNIQUE_NAMES[:techniques]
    routes = [simulate(seed, queries=FRAMES, techniques=techniques) for seed in range(ROUTES)]
    return Experience.of([_by_cost(route, names) for route in routes], pooled=True)


def _by_cost(bank: ScoreBank, names: Sequence[str]) -> ScoreBank:
    """The bank's techniques in order of cost, called by ``names`` in that order."""
    order = np.argsort(bank.seconds, kind="stable")
    return ScoreBank(
        bank.scores[order],
        names,
        bank.seconds[order],
        tolerance=bank.tolerance,
        ground_truth=bank.truth,
    )


@dataclass(eq=False)
class SwitchHit:
    """Runs the cheapest technique; while none is probably right, the one that helps most there."""

    experience: Experience  # of the route's techniques, in their order
    first: int  # index of the technique to begin with
    threshold: float = THRESHOLD  # τ, correctness at which it stops

    def reset(self, references: int, techniques: int) -> None:
        """Nothing to forget; a ValueError for more or fewer techniques than it has learned of."""
        known = len(self.experience.helps)
        if techniques != known:
            raise ValueError(
                f"this SwitchHit has learned of {known} techniques, the route has {techniques}; "
                "let it learn from routes with the same ones"
            )

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """Best place of the technique most probably right, and that probability."""
        helps = self.experience.helps.copy()
        current, found = self.first, (0, -1.0)
        for _ in range(len(helps)):
            z = standardised(np.asarray(run(current), np.float64))
            place = int(z.argmax())
            p = self.experience.correctness(current, float(z[place]))
            if p > found[1]:
                found = place, p
            if p >= self.threshold:
                break
            helps[:, current] = -1.0
            current = int(helps[current].argmax())
        return found


def switchhit(argument: str | None, context: Context) -> SwitchHit:
    """``switchhit`` or ``switchhit:TAU``, learned from simulated routes."""
    threshold = THRESHOLD
    if argument is not None:
        threshold = number("switchhit", argument, "TAU", argument, 0.0, 1.0)
    by_cost = np.argsort(context.seconds, kind="stable")
    rank = np.argsort(by_cost)  # (T,) of each technique
    experience = simulated(len(by_cost)).arranged(rank)
    return SwitchHit(experience, int(by_cost[0]), threshold)


POLICY = RegisteredPolicy(
    "switchhit",
    switchhit,
    PEER,
    "SwitchHit-style",
    needs_truth="of routes to learn from",
    colour="#B15928",
    marker="X",
)
