"""Judging a selector on routes that no training sees."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from amusic_gym.envs.sources import SimulatedRoutes
from amusic_gym.evaluation.metrics import compute
from amusic_gym.evaluation.rollout import Job, rollouts
from amusic_gym.policies.protocol import Selector
from amusic_gym.routes.simulate import population

HELD_OUT_SEED = 2_000_000_000
COMPUTE_WEIGHTS = (0.03, 0.1, 0.3, 1.0, 3.0)


class Evaluation(NamedTuple):
    """Means over held-out routes and compute weights.

    Attributes:
        timesteps: frames of training so far.
        score: correct − λ · compute per frame, with true correctness.
        accuracy: share of frames with a true place.
        compute: seconds / (frames · Σ seconds).
        p_correct: mean p̂; far above ``accuracy`` it says that the selector fools it.
    """

    timesteps: int
    score: float
    accuracy: float
    compute: float
    p_correct: float


class HeldOut:
    """Simulated routes of seeds that training never draws.

    Args:
        routes: how many.
        statistic: SIC's statistic.
    """

    def __init__(self, routes: int, statistic: str) -> None:
        source = SimulatedRoutes(
            population(statistic), pool=routes, seed=HELD_OUT_SEED, keep=routes
        )
        rng = np.random.default_rng(0)
        banks = [source.sample(rng, i)[0] for i in range(routes)]
        self.jobs = [Job(bank, weight) for bank in banks for weight in COMPUTE_WEIGHTS]
        self.statistic = statistic

    def evaluate(self, selector: Selector, timesteps: int) -> Evaluation:
        """Run the selector on every route at every compute weight."""
        traces = rollouts(selector, self.jobs, name="selector", statistic=self.statistic)
        accuracy = np.array([trace.correct.mean() for trace in traces])
        cost = np.array([compute(trace) for trace in traces])
        weights = np.array([job.compute_weight for job in self.jobs], np.float64)
        return Evaluation(
            timesteps,
            float((accuracy - weights * cost).mean()),
            float(accuracy.mean()),
            float(cost.mean()),
            float(np.mean([trace.p_correct.mean() for trace in traces])),
        )
