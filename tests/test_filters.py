"""Peers that follow the robot from frame to frame, against plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from amusic_baselines import make_policy
from amusic_baselines.lazygraph import RECENT
from env_cases import random_bank
from rollout_cases import localise

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.policies.protocol import Context


def make(spec: str, bank: ScoreBank):
    return make_policy(spec, Context.of(bank, statistic="evidence"))


def accuracy(spec: str, bank: ScoreBank) -> float:
    places, _ = localise(make(spec, bank), bank)
    return float(bank.truth.correct(np.array(places)).mean())


def driven(standing: float, seed: int = 0) -> ScoreBank:
    """Two noisy techniques along 30 places of a map of 40, standing on some of the frames."""
    rng = np.random.default_rng(seed)
    places = np.minimum(np.cumsum(rng.random(45) >= standing), 39)
    scores = rng.normal(size=(2, 45, 40))
    scores[:, np.arange(45), places] += 2.5
    return ScoreBank(scores, ["A", "B"], [1, 2], tolerance=1, ground_truth=places)


def xu_by_loops(bank, techniques, back, ahead, delta):
    """Places and confidences, every sum a loop over places."""
    belief, rates, answers = None, {}, []
    size = bank.references
    for q in range(bank.queries):
        likelihood = [1.0] * size
        for t in techniques:
            distances = [-float(s) for s in bank.row(t, q)]
            if t not in rates:
                low, high = np.quantile(distances, [0.025, 0.975])
                rates[t] = math.log(delta) / (high - low)
            for c in range(size):
                likelihood[c] *= math.exp(-rates[t] * (distances[c] - min(distances)))
        if belief is None:
            moved = [1.0] * size
        else:
            moved = [
                sum(belief[c - step] for step in range(-back, ahead + 1) if 0 <= c - step < size)
                for c in range(size)
            ]
        belief = [m * v for m, v in zip(moved, likelihood, strict=True)]
        belief = [mass / sum(belief) for mass in belief]
        peak, reach = belief.index(max(belief)), back + ahead + 1
        near = range(max(0, peak - reach), min(size, peak + reach + 1))
        mass = sum(belief[c] for c in near)
        answers.append((round(sum(c * belief[c] for c in near) / mass), mass))
    return zip(*answers, strict=True)


@pytest.mark.parametrize(
    ("spec", "techniques", "back", "ahead", "delta"),
    [("xu", (0, 1), 2, 9, 5), ("xu:A/0/2/50", (0,), 0, 2, 50), ("xu:1/1/20", (0, 1), 1, 1, 20)],
)
def test_xu_is_the_loops(spec, techniques, back, ahead, delta):
    bank = driven(0.3)
    places, confidence = localise(make(spec, bank), bank)
    expected, sure = xu_by_loops(bank, techniques, back, ahead, delta)
    assert list(places) == list(expected)
    np.testing.assert_allclose(confidence, list(sure), rtol=1e-9)


def test_xu_follows_a_drive_that_single_rows_do_not_show():
    bank = driven(0.5, seed=2)
    assert accuracy("xu:A/0/2/50", bank) > accuracy("raw:A", bank) + 0.1


def test_a_first_row_that_says_nothing_sets_no_rate():
    scores = random_bank(1, techniques=1, queries=6, references=9).scores.copy()
    scores[:, 0] = 3.0
    bank = ScoreBank(scores, ["A"], [1], tolerance=1, ground_truth=np.arange(6))
    policy = make("xu", bank)
    _, confidence = localise(policy, bank)
    assert np.isfinite(np.array(confidence)).all()
    assert policy._rates[0] > 0


def graph_by_loops(bank, fan_out, rate, non_match):
    """Every frame's place: all open nodes are looked through for the cheapest, in a plain list."""
    costs, paths, opened, best, answers = [], {}, [], None, []
    for q in range(bank.queries):
        rows = [bank.row(t, q).astype(float) for t in range(len(bank.techniques))]
        similar = sum((row - row.min()) / (row.max() - row.min()) for row in rows) / len(rows)
        costs.append([min(non_match, 1 / s) if s > 0 else non_match for s in similar.tolist()])
        row = -2 if q == 0 else -1
        while row != q - 1:
            if q == 0:
                row, place, cost, near = -1, -1, 0.0, range(bank.references)
            else:
                cost, row, place = node = min(opened)
                opened.remove(node)
                mean = best[0] / (best[1] + 1)
                if node != best and not cost + (best[1] - row) * mean * rate < best[0]:
                    row = -1
                    continue
                near = [c for c in range(bank.references) if abs(c - place) <= fan_out]
            for child in near:
                if (row + 1, child) not in paths:
                    paths[row + 1, child] = (cost + costs[row + 1][child], place)
                    opened.append((paths[row + 1, child][0], row + 1, child))
            found = min(near, key=lambda c, at=row + 1: (costs[at][c], c))
            total = paths[row + 1, found][0]
            if best is None or row + 1 > best[1] or (row + 1 == best[1] and total < best[0]):
                best = (total, row + 1, found)
        at, place, passed = q, best[2], []
        while at >= 0:
            passed.append(1 / costs[at][place])
            at, place = at - 1, paths[at, place][1]
        answers.append((best[2], sum(passed[:RECENT]) / len(passed[:RECENT])))
    return zip(*answers, strict=True)


@pytest.mark.parametrize(("fan_out", "rate", "non_match"), [(5, 0.7, 6.0), (2, 0.9, 3.0)])
@pytest.mark.parametrize("standing", [0.0, 0.4])
def test_lazygraph_is_the_loops(fan_out, rate, non_match, standing):
    bank = driven(standing)
    policy = make(f"lazygraph:{fan_out}/{rate}/{non_match}", bank)
    places, confidence = localise(policy, bank)
    expected, sure = graph_by_loops(bank, fan_out, rate, non_match)
    assert list(places) == list(expected)
    np.testing.assert_allclose(confidence, list(sure), rtol=1e-12)


def test_lazygraph_leaves_most_nodes_alone_and_still_follows():
    bank = driven(0.4, seed=1)
    policy = make("lazygraph:2/0.7/6", bank)
    places, _ = localise(policy, bank)
    assert bank.truth.correct(np.array(places)).mean() > 0.8
    assert sum(map(len, policy._paths[1:])) < 0.5 * bank.references * bank.queries
