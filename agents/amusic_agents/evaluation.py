"""Judging a selector on routes that no training sees."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.sources import SimulatedRoutes, ordinary
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation.metrics import compute
from amusic_gym.evaluation.rollout import Job, rollouts
from amusic_gym.policies.protocol import Selector
from amusic_gym.routes.simulate import Simulation, population

HELD_OUT_SEED = 2_000_000_000
COMPUTE_WEIGHTS = (0.03, 0.1, 0.3, 1.0, 3.0)


class Evaluation(NamedTuple):
    """Means over held-out routes and compute weights."""

    timesteps: int  # frames of training so far
    score: float  # correct − λ · compute per frame, with true correctness
    accuracy: float  # share of frames with a true place
    compute: float  # seconds / (frames · Σ seconds)
    p_correct: float  # mean p̂; far above ``accuracy`` where the selector exploits its errors


def measure(selector: Selector, jobs: Sequence[Job], **options: Any) -> NDArray[np.float64]:
    """(3, J) accuracy, compute and mean p̂ of a selector on J routes, with options of `rollouts`."""
    traces = rollouts(selector, jobs, name="selector", **options)
    rows = [(trace.correct.mean(), compute(trace), trace.p_correct.mean()) for trace in traces]
    return np.array(rows).T


def held_out_source(simulation: Simulation, routes: int) -> SimulatedRoutes:
    """So many simulated routes, of seeds that training never draws."""
    return SimulatedRoutes(simulation, pool=routes, seed=HELD_OUT_SEED, keep=routes)


def held_out_routes(simulation: Simulation, routes: int) -> list[ScoreBank]:
    """The routes of `held_out_source`, one after the other."""
    source = held_out_source(simulation, routes)
    rng = np.random.default_rng(0)
    return [source.sample(rng, i)[0] for i in range(routes)]


Act = Callable[[NDArray[np.float32], Mapping[str, Any]], NDArray[Any]]
"""Actions (N, ...) from observations (N, D) and the vector environment's infos."""


def mean_reward(
    act: Act,
    *,
    compute_weight: float,
    routes: int = 64,
    wrap: Callable[[Any], Any] = lambda env: env,
    **arguments: Any,
) -> float:
    """Mean reward per frame on the routes that ``amusic rewards`` drives, to be compared with it.

    Args:
        act: chooses actions for N = ``routes`` routes at once; those of ended ones do not count.
        compute_weight: λ.
        routes: how many.
        wrap: puts the native vector environment into wrappers.
        arguments: others of the environment.
    """
    source = held_out_source(ordinary(SICSettings.statistic), routes)
    arguments = {"compute_weight": compute_weight, **arguments}
    env = wrap(TechniqueSelectionVectorEnv(routes, source, **arguments))
    observation, info = env.reset(options={"bank": np.arange(routes)})
    driving, total, frames = np.ones(routes, np.bool_), np.zeros(routes), np.zeros(routes)
    while driving.any():
        observation, reward, terminated, _, info = env.step(act(observation, info))
        total += np.where(driving, reward, 0.0)
        frames += driving
        driving &= ~terminated
    return float((total / frames).mean())


class HeldOut:
    """Simulated routes of seeds that training never draws.

    Args:
        routes: how many.
        statistic: SIC's.
        within: range of λ; of `COMPUTE_WEIGHTS` those in it count, or its middle if none is.
    """

    def __init__(
        self, routes: int, statistic: str, within: tuple[float, float] = (0.0, math.inf)
    ) -> None:
        low, high = within
        weights = [weight for weight in COMPUTE_WEIGHTS if low <= weight <= high]
        banks = held_out_routes(population(statistic), routes)
        self.jobs = [
            Job(bank, weight) for bank in banks for weight in weights or [math.sqrt(low * high)]
        ]
        self.statistic = statistic

    def evaluate(self, selector: Selector, timesteps: int) -> Evaluation:
        """Run the selector on every route at every compute weight."""
        accuracy, cost, p_correct = measure(selector, self.jobs, statistic=self.statistic)
        weights = np.array([job.compute_weight for job in self.jobs], np.float64)
        means = (accuracy - weights * cost, accuracy, cost, p_correct)
        return Evaluation(timesteps, *(float(each.mean()) for each in means))
