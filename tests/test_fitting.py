"""Fitting the belief's rates, and the scripts around it."""

from __future__ import annotations

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.belief import Rates, fitted
from amusic_gym.estimation.belief.fitting import (
    SEARCHED,
    Drive,
    activity,
    from_unit,
    score,
    to_unit,
)
from amusic_gym.routes.simulate import planted, simulate

ROOT = Path(__file__).resolve().parent.parent


def script(name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(ROOT / "scripts" / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def bank():
    return simulate(3, queries=60, techniques=3)


def test_every_rate_is_searched_between_limits_that_hold_what_ships():
    assert tuple(SEARCHED) == Rates._fields
    for name, value in fitted()._asdict().items():
        low, high, _ = SEARCHED[name]
        assert low <= value <= high, name


def test_rates_survive_the_way_to_the_unit_cube_and_back():
    np.testing.assert_allclose(from_unit(to_unit(fitted())), fitted(), rtol=1e-9)
    for name, value in from_unit(np.full(len(SEARCHED), 7.0))._asdict().items():
        assert value == pytest.approx(SEARCHED[name].high)


def test_a_drive_says_what_the_environment_says(bank):
    ran = activity(np.random.default_rng(0), bank)
    places, beliefs = Drive(bank, ran).drive(fitted())
    env = TechniqueSelectionVectorEnv(1, bank, statistic="belief")
    env.reset(options={"start": 0})
    seen = [env.step(ran[frame : frame + 1])[-1]["prediction"][0] for frame in range(60)]
    assert places.tolist() == seen
    inside = bank.truth.matrix()[np.arange(60), places]
    assert (beliefs <= 1.0 + 1e-9).all()
    assert (beliefs[inside, 1] > 0.0).all()


def test_the_score_is_that_of_the_beliefs(bank):
    drives = [Drive(bank, np.ones((60, 3), np.bool_)), Drive(bank, np.eye(3, dtype=bool)[[0] * 60])]
    with ThreadPoolExecutor(2) as pool:
        loss, accuracy = score(drives, fitted(), pool)
    known = bank.truth.has_place
    losses, right = [], []
    for drive in drives:
        places, beliefs = drive.drive(fitted())
        losses.append(-np.log(np.maximum(beliefs[known, 1], 1e-3)).mean())
        right.append(bank.truth.correct(places)[known].mean())
    assert loss == pytest.approx(np.mean(losses))
    assert accuracy == pytest.approx(np.mean(right))


def test_a_filter_that_listens_finds_more_than_a_deaf_one():
    bank = planted(0, frames_per_regime=30, references=200)
    drive = Drive(bank, np.ones((bank.queries, 4), np.bool_))
    deaf = fitted()._replace(sharpness=1e-6)
    assert drive.score(fitted())[0] < 0.5 * drive.score(deaf)[0]


@pytest.mark.parametrize("seed", range(30))  # all five kinds of activity
def test_something_always_runs(bank, seed):
    assert activity(np.random.default_rng(seed), bank).any(axis=1).all()


def test_fit_belief_writes_rates_that_it_can_begin_with(tmp_path):
    out = tmp_path / "rates.json"
    words = ("--routes", 2, "--held-out", 2, "--generations", 1, "--threads", 1, "--out", out)
    done = script("fit_belief.py", *words)
    assert done.returncode == 0, done.stderr
    table = json.loads(out.read_text("utf-8"))
    assert set(table["rates"]) == set(Rates._fields)
    assert "--generations 1" in table["made_by"]
    out.write_text('{"rates": {"sharpness": 1}}', encoding="utf-8")
    refused = script("fit_belief.py", *words, "--start", out)
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert "holds no rates" in refused.stderr


def test_belief_study_writes_a_line_per_part(tmp_path):
    out = tmp_path / "belief.md"
    done = script("belief_study.py", "--simulated", 1, "--seeds", 1, "--out", out)
    assert done.returncode == 0, done.stderr
    lines = out.read_text("utf-8").splitlines()
    assert len(lines) == 2 + 3 + 12
    assert all(line.count("|") == 8 for line in lines)
    refused = script("belief_study.py", "--out", out)
    assert refused.returncode == 2
    assert "no routes" in refused.stderr
