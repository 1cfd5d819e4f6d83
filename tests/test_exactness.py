"""Ten thousand random frames of every configuration: each place and selection is the loops'.

A third of them on each kind of bank.
"""

from __future__ import annotations

import numpy as np
import pytest
from env_cases import noisy_bank
from selection_cases import assert_details, assert_route, follow

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic import state as sic
from amusic_gym.estimation.sic.sums import TILE

pytestmark = pytest.mark.slow

FRAMES = 10_000
QUERIES, PLACES, WIDTH = 40, 16, 3
NOWHERE = np.full(QUERIES, -1)


def plain(rng: np.random.Generator) -> ScoreBank:
    """Scores as techniques give them: no two alike."""
    scores = rng.standard_normal((WIDTH, QUERIES, PLACES)).astype(np.float32)
    return ScoreBank(
        scores, list("ABC"), rng.uniform(0.1, 2.0, WIDTH), tolerance=1, ground_truth=NOWHERE
    )


def aliased(rng: np.random.Generator) -> ScoreBank:
    """A map of a few places that come again and again, seen without noise: exact ties."""
    period = int(rng.integers(1, 7))
    scores = rng.standard_normal((WIDTH, QUERIES, period)).astype(np.float32)
    scores = np.tile(scores, PLACES // period + 1)[:, :, :PLACES]
    return ScoreBank(
        scores, list("ABC"), rng.uniform(0.1, 2.0, WIDTH), tolerance=1, ground_truth=NOWHERE
    )


def levels(rng: np.random.Generator) -> ScoreBank:
    """Scores out of a few whole numbers, some rows constant."""
    return noisy_bank(rng, WIDTH, QUERIES, PLACES, levels=int(rng.integers(2, 9)))


KINDS = [plain, aliased, levels]


def check(make, frames, statistic, gamma, history):
    """Drive random routes and compare every frame with the loops.

    By turns they carry places on, discount, do both, or neither; and may be idle, or not.
    """
    rng = np.random.default_rng(17)
    banks = [make(rng) for _ in range(frames // QUERIES)]
    envs = {}
    for number, bank in enumerate(banks):
        carry, discount, idle, few = (bool(number >> bit & 1) for bit in range(4))
        chosen = SICSettings(statistic, 10 if few else 50, history, gamma, carry, discount)
        actions = rng.random((QUERIES, WIDTH + 1)) < rng.choice([0.2, 0.5, 0.9])
        actions[:, -1] = rng.random(QUERIES) < 0.04
        arguments = {**vars(chosen), "reselection": 6, "allow_idle": idle}
        if number < 16:
            envs[number] = TechniqueSelectionEnv(banks, **arguments)
        env = envs[number % 16]
        env.reset(options={"bank": number})
        infos = [env.step(action)[4] for action in actions]
        expected = follow(bank, actions, chosen, block=6, idle=idle)
        assert_route(infos, expected, bank.seconds)
        assert_details(infos, expected, bank.tolerance, statistic)


@pytest.mark.parametrize("make", KINDS)
@pytest.mark.parametrize("history", [5, 1000])
@pytest.mark.parametrize("gamma", [1.0, 0.9])
@pytest.mark.parametrize("statistic", ["evidence", "mean"])
def test_every_place_and_selection_is_the_loops(statistic, gamma, history, make):
    check(make, FRAMES // len(KINDS), statistic, gamma, history)


@pytest.mark.parametrize("make", [plain, aliased])
@pytest.mark.parametrize("history", [3, 12, 1000])
def test_rows_that_wait_on_large_maps_change_nothing(monkeypatch, history, make):
    monkeypatch.setattr(sic, "LARGE", 1)
    check(make, FRAMES // 5, "evidence", 1.0, history)


def test_observations_on_a_large_map_are_those_of_rows_added_at_once(monkeypatch):
    rng, count = np.random.default_rng(3), 2 * TILE + 7
    scores = rng.standard_normal((2, 60, count)).astype(np.float32)
    bank = ScoreBank(scores, ["A", "B"], [1.0, 2.0], tolerance=1, ground_truth=np.full(60, -1))
    actions = rng.random((60, 3)) < 0.6
    actions[:, -1] = rng.random(60) < 0.1
    seen = []
    for large in (1, count + 1):
        monkeypatch.setattr(sic, "LARGE", large)
        env = TechniqueSelectionEnv(bank, statistic="evidence", reselection=4)
        env.reset()
        seen.append([env.step(action)[0] for action in actions])
        assert env.task.episodes.estimator.state.marks["depth"].all() == (large == 1)
    np.testing.assert_array_equal(*seen)
