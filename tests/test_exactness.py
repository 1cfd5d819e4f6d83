"""Ten thousand random frames of every configuration: each place and selection is the loops'."""

from __future__ import annotations

import numpy as np
import pytest
from env_cases import noisy_bank
from selection_cases import assert_route, follow

from amusic_gym.bank import ScoreBank
from amusic_gym.env import TechniqueSelectionEnv

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


@pytest.mark.parametrize("make", [plain, aliased, levels])
@pytest.mark.parametrize("history", [5, 1000])
@pytest.mark.parametrize("gamma", [1.0, 0.9])
@pytest.mark.parametrize("statistic", ["evidence", "mean"])
def test_every_place_and_selection_is_the_loops(statistic, gamma, history, make):
    rng = np.random.default_rng(17)
    for number in range(FRAMES // QUERIES):
        bank, candidates = make(rng), (10, 50)[number % 2]
        actions = rng.random((QUERIES, WIDTH + 1)) < rng.choice([0.2, 0.5, 0.9])
        actions[:, -1] = rng.random(QUERIES) < 0.04
        env = TechniqueSelectionEnv(
            bank,
            statistic=statistic,
            candidates=candidates,
            history=history,
            gamma=gamma,
            reselection=6,
        )
        env.reset()
        infos = []
        for action in actions:
            info = env.step(action)[4]
            infos.append({**info, "ran": info["ran"].tolist()})
        sic = (candidates, history, gamma, statistic)
        assert_route(infos, follow(bank, actions, 6, 0.7, sic), bank.seconds)
