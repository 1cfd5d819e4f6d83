"""p̂ where the robot leaves the map after a good stretch."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from corridor import data_folder
from recordings import ROUTES

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.extraction import extract
from amusic_gym.routes.simulate import POPULATION, TOURS, Simulation

pytestmark = pytest.mark.slow

GOOD, AWAY = 50, 60
"""Frames on the map, and then off it."""

SURE = 0.9


def estimates(bank: ScoreBank, statistic: str) -> np.ndarray:
    """p̂ (Q,) with all techniques."""
    env = TechniqueSelectionVectorEnv(1, bank, statistic=statistic)
    env.reset(options={"start": 0})
    actions = np.ones((1, len(bank.techniques)))
    return np.array([env.step(actions)[4]["p_correct"][0] for _ in range(bank.queries)])


def joined(names: Iterable[str], folder: Path) -> ScoreBank:
    """A bank of the first recording's map and frames, and then the second one's frames."""
    first, second = (ROUTES[name] for name in names)
    data = data_folder(first[0])
    if not all((data / name).is_dir() for name in (*first, *second)):
        pytest.skip("AMUSIC_DATA holds no corridor/ or no gardens_point/")
    frames = sorted((data / first[1]).iterdir())[:GOOD]
    frames += sorted((data / second[1]).iterdir())[30 : 30 + AWAY]
    folder.mkdir()
    for number, frame in enumerate(frames):
        (folder / f"{number:03}{frame.suffix}").symlink_to(frame)
    places = len(list((data / first[0]).iterdir()))
    near = np.abs(np.arange(len(frames))[:, None] - np.arange(places)) <= 2
    near[GOOD:] = False
    names = ("hog", "calc", "netvlad")
    return extract(data / first[0], folder, names, ground_truth=near, tolerance=2)


@pytest.mark.parametrize("statistic", ["evidence", "belief"])
@pytest.mark.parametrize("names", [("corridor", "gardens_night"), ("gardens_night", "corridor")])
def test_15_p_falls_where_another_building_follows(names, statistic, tmp_path):
    p = estimates(joined(names, tmp_path / "run"), statistic)
    assert (p[20:GOOD] >= SURE).mean() > 0.6
    assert (p[GOOD:] >= SURE).mean() <= 0.06  # before: 0.5 with evidence


@pytest.mark.parametrize(("statistic", "routes"), [("evidence", TOURS), ("belief", POPULATION)])
def test_15_p_falls_on_simulated_routes_that_leave_the_map(statistic: str, routes: Simulation):
    model = replace(routes, leaves=1.0)
    stays, left = [], []
    for seed in range(20):
        bank = model.route(np.random.default_rng([9, seed]))
        p, on = estimates(bank, statistic), np.diff(bank.truth.indptr) > 0
        stays.append((p[on] >= SURE).mean())
        left.append((p[~on] >= SURE).mean())
    assert np.mean(left) <= 0.15
    assert np.mean(stays) >= 0.7
