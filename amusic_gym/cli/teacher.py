"""The teacher of an imitation: for every part of the range of λ, the cascade that pays most."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from amusic_agents.config import TrainingConfig
from amusic_agents.evaluation import measure
from amusic_agents.teachers import ByWeight, partition
from amusic_agents.training import simulated_routes
from amusic_baselines.cascade import Cascade
from tqdm import tqdm

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.rollout import Job
from amusic_gym.utils.reading import read_json
from amusic_gym.utils.storage import write_whole

FILE = "teacher.json"
PARTS = 12  # into how many the range of λ is cut
ROUTES = 32  # simulated training routes on which the cascades are measured
EVERYTHING = 99  # always running so many of the cheapest techniques is running all


class Parameters(NamedTuple):
    """Arguments of a :class:`amusic_baselines.cascade.Cascade`."""

    cheap: int
    hold: int
    threshold: float


GRID: tuple[Parameters, ...] = (
    *(Parameters(cheap, 1, 0.0) for cheap in (1, 2, 3, EVERYTHING)),  # never in doubt
    *(Parameters(*each) for each in product((1, 2, 3), (1, 3, 8, 20), (0.5, 0.7, 0.9))),
)


class Choice(NamedTuple):
    """The cascade for a λ, and what it reached there."""

    compute_weight: float  # λ
    parameters: Parameters  # of the cascade
    score: float  # correct − λ · compute per frame, with true correctness
    accuracy: float  # share of frames with a true place
    compute: float  # seconds / (frames · Σ seconds)


def make_teacher(
    out: Path,
    config: TrainingConfig,
    *,
    resume: bool = False,
    routes: int = ROUTES,
    grid: Sequence[Parameters] = GRID,
    progress: bool = True,
) -> ByWeight:
    """The teacher of a run: chosen, and written to its ``teacher.json``."""
    path = out / FILE
    low, high = config.compute_weights
    if resume and path.exists():
        choices = _read(path)
    else:
        _, middles = partition((low, high), PARTS if low < high else 1)
        how: dict[str, Any] = {"statistic": config.statistic, "environment": config.environment()}
        drawn = teacher_routes(config, routes)
        choices = choose_cascades(drawn, middles, grid=grid, progress=progress, **how)
        rows = [
            {**choice._asdict(), "parameters": choice.parameters._asdict()} for choice in choices
        ]
        write_whole(path, (json.dumps(rows, indent=1) + "\n").encode())
    edges, _ = partition((low, high), len(choices))
    return ByWeight(edges, [Cascade(*choice.parameters) for choice in choices])


def teacher_routes(config: TrainingConfig, routes: int = ROUTES) -> list[ScoreBank]:
    """Simulated routes of a training's seed; no evaluation uses them."""
    source = simulated_routes(replace(config, pool=routes))
    rng = np.random.default_rng(0)
    return [source.sample(rng, i)[0] for i in range(routes)]


def choose_cascades(
    banks: Sequence[ScoreBank],
    weights: Sequence[float],
    *,
    statistic: str,
    environment: Mapping[str, bool] | None = None,
    grid: Sequence[Parameters] = GRID,
    progress: bool = True,
) -> list[Choice]:
    """The cascade of the highest score for each λ; among equals the first of the grid.

    A cascade does not look at λ, so each drives every route once. Correctness is the true one, not
    p̂.
    """
    jobs = [Job(bank) for bank in banks]
    options = {"statistic": statistic, **(environment or {})}
    bar = tqdm(grid, desc="choosing the teacher", disable=not progress)
    means = [measure(Cascade(*each), jobs, **options)[:2].mean(axis=1) for each in bar]
    accuracy, cost = np.array(means).T
    choices = []
    for weight in weights:
        scores = accuracy - weight * cost
        best = int(scores.argmax())
        reached = (scores[best], accuracy[best], cost[best])
        choices.append(Choice(float(weight), grid[best], *map(float, reached)))
    return choices


def _read(path: Path) -> list[Choice]:
    rows = read_json(path, "delete it to choose again", list)
    try:
        return [Choice(**{**row, "parameters": Parameters(**row["parameters"])}) for row in rows]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is damaged ({error}); delete it to choose again") from error
