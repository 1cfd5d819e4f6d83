"""Estimated correctness: the compiled p̂ against the documented formula, the fit, the script."""

from __future__ import annotations

import importlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from env_cases import random_actions, random_bank

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.estimation import calibration
from amusic_gym.estimation.settings import STATISTICS

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture
def script(monkeypatch):
    """``scripts/calibrate.py``, imported."""
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module("calibrate")


def log_ratio(share: float, other: float) -> float:
    return math.log(max(share, 1e-12)) - math.log(max(other, 1e-12))


def log_odds(share: float) -> float:
    return log_ratio(share, 1.0 - share)


@pytest.mark.parametrize("statistic", STATISTICS)
def test_coefficients_that_ship_are_as_many_as_the_formula_has(statistic):
    shipped = calibration.coefficients(statistic)
    assert shipped.shape == ((7,) if statistic == "belief" else (13,))
    assert np.isfinite(shipped).all()
    surer = [1, 6] if statistic == "belief" else [2, 4, 5, 7, 9, 10, 12]
    assert (shipped[surer] > 0.0).all()  # track, support, margin, on the map; ...


def test_the_estimate_of_the_belief_is_the_documented_one(bank):
    b = calibration.coefficients("belief")
    env = TechniqueSelectionEnv(bank, statistic="belief", allow_idle=True)
    env.reset(seed=0)
    said_mean, seen = 0.0, set()
    for action in random_actions(5, 40, (3,), reselect=0.5):
        info = env.step(action)[4]
        if info["prediction"] < 0:
            continue
        belief = env.task.episodes.estimator.state.beliefs[0, 0]
        said = belief["log_likelihood"]
        if info["ran"].any():
            said_mean += 0.2 * (said / info["ran"].sum() - said_mean)
        ratio = log_ratio(belief["share"], belief["rival"])
        assert info["margin"] == pytest.approx(ratio)
        logit = b[0] + b[1] * log_odds(belief["share"]) + b[2] * ratio
        logit += b[3] * said + b[4] * said_mean
        on_map = env.task.episodes.state.routes[0]["on_map"]
        p = 1.0 / (1.0 + math.exp(-logit)) / (1.0 + math.exp(-b[5] - b[6] * on_map))
        assert info["p_correct"] == pytest.approx(p)
        assert info["confidence"] == pytest.approx(log_odds(p))
        inputs = calibration.belief_design(log_odds(belief["share"]), ratio, said, said_mean)
        both = [inputs @ b[:5], *(calibration.map_design([on_map]) @ b[5:])]
        assert calibration.logistic(np.array(both)).prod() == pytest.approx(p)
        seen.add(round(info["p_correct"], 6))
    assert len(seen) > 20


@pytest.mark.parametrize("carry", [True, False])
@pytest.mark.parametrize("statistic", ["evidence", "mean"])
def test_the_estimate_of_sic_is_the_documented_one(bank, statistic, carry):
    b = calibration.coefficients(statistic)
    seen = set()
    for rival in (True, False):
        candidates, carries = (50, carry) if rival else (1, False)
        env = TechniqueSelectionEnv(bank, statistic=statistic, candidates=candidates, carry=carries)
        env.reset(seed=0)
        track, before = 0, -1
        for action in random_actions(5, 40, (3,), reselect=0.5):
            info = env.step(action if rival else [0, 1, 0])[4]
            place = info["prediction"]
            track = track + 1 if before >= 0 and place == before + 1 else 0
            before = place
            known = env.task.episodes.state
            route = known.routes[0]
            statistic_ = info["confidence"] * known.slots[0]["discount"][info["technique"]]
            s, t, r = math.asinh(statistic_), math.log(1 + track), route["on_map"]
            if rival:
                h, u, m = route["heard"], route["support"], math.asinh(info["margin"])
                assert 0.0 <= u <= h <= 1.0
                drive = b[0] + b[1] * s + b[2] * t + b[3] * h + b[4] * u + b[5] * m
                late = b[6] + b[7] * r
                rivals = ([h], [u], [info["margin"]])
                inputs, part = calibration.design([statistic_], [track], rivals), b[:8]
            else:
                drive, late = b[8] + b[9] * s + b[10] * t, b[11] + b[12] * r
                inputs, part = calibration.design([statistic_], [track], None), b[8:]
            expected = 1.0 / (1.0 + math.exp(-drive)) / (1.0 + math.exp(-late))
            assert info["p_correct"] == pytest.approx(expected)
            both = [inputs @ part[:-2], calibration.map_design([route["on_map"]]) @ part[-2:]]
            assert calibration.logistic(np.array(both)).prod() == pytest.approx(expected)
            seen.add((rival, round(info["p_correct"], 6)))
    assert min(sum(one[0] == rival for one in seen) for rival in (True, False)) >= 5


def test_design_compresses_what_sic_gives():
    rivals = ([0.0, 0.75], [0.0, 0.5], [1.0, -3.0])
    found = calibration.design([0.0, 2.0], [0, 7], rivals)
    expected = [
        [1, 0, 0, 0, 0, math.asinh(1)],
        [1, math.asinh(2), math.log(8), 0.75, 0.5, math.asinh(-3)],
    ]
    np.testing.assert_allclose(found, expected)
    np.testing.assert_allclose(calibration.design([2.0], [7], None), [expected[1][:3]])


# ---- what the other techniques have to say -----------------------------------------------


def independent(seed: int, queries: int = 30, references: int = 60) -> np.ndarray:
    """Rows (Q, R) of noise in which query q stands out at place q."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(queries, references)) + 2.5 * np.eye(queries, references)


def said_of(rows: list[np.ndarray], actions, statistic: str) -> list[tuple[float, ...]]:
    """Of every frame: place, p̂, heard and support."""
    seconds, truth = np.ones(len(rows)), np.arange(len(rows[0]))
    names = [f"T{t}" for t in range(len(rows))]
    bank = ScoreBank(np.stack(rows), names, seconds, tolerance=2, ground_truth=truth)
    env = TechniqueSelectionEnv(bank, statistic=statistic)
    env.reset(seed=0)
    found = []
    for action in actions:
        info = env.step(action)[4]
        route = env.task.episodes.state.routes[0]
        others = (float(route["heard"]), float(route["support"]))
        found.append((info["prediction"], info["p_correct"], *others))
    return found


@pytest.mark.parametrize("statistic", ["evidence", "mean"])
def test_a_copy_of_the_chosen_technique_confirms_nothing(statistic):
    row, other = independent(0), independent(1)
    alone = said_of([row], np.ones((30, 1)), statistic)
    doubled = said_of([row, row], np.ones((30, 2)), statistic)
    np.testing.assert_allclose(doubled, alone, rtol=1e-12, atol=1e-12)
    assert not np.any([one[2:] for one in alone])
    scaled = said_of([row, 3.0 * row + 7.0], np.ones((30, 2)), statistic)  # another scale
    np.testing.assert_allclose(scaled, alone, atol=1e-5)
    both = said_of([row, other], np.ones((30, 2)), statistic)
    again = said_of([row, other, row, other], np.ones((30, 4)), statistic)
    np.testing.assert_allclose(again, both, rtol=1e-12, atol=1e-12)
    assert min(one[2] for one in both) > 0.3


@pytest.mark.parametrize("statistic", ["evidence", "mean"])
def test_an_independent_technique_that_ran_earlier_and_agrees_makes_p_rise(statistic):
    """It ran on frame 5 alone: what it said then decides how p̂ goes on from there."""
    row, other = independent(0), independent(1)
    other[5, 5] = 4.0
    against = np.roll(other, 30, axis=1)  # the same, of another place
    row[np.arange(30), np.arange(30)] += 3.0  # the surer one: it is trusted on all frames
    first = np.array([[1, 0]] * 5 + [[1, 1]] + [[1, 0]] * 6)
    agreed, opposed = (said_of([row, each], first, statistic) for each in (other, against))
    alone = said_of([row], np.ones((12, 1)), statistic)
    for age, frame in enumerate(range(6, 12), start=1):
        places = {said[frame][0] for said in (agreed, opposed, alone)}
        assert places == {frame}
        weight = agreed[frame][2]
        assert agreed[frame][3] == weight
        assert weight == pytest.approx(agreed[5][2] * 0.98**age)
        assert opposed[frame][2] > 0.0 == opposed[frame][3]
        assert agreed[frame][1] > alone[frame][1] > 0.0
        assert agreed[frame][1] > opposed[frame][1]


def test_fit_finds_the_coefficients_that_the_outcomes_came_from():
    rng = np.random.default_rng(0)
    inputs = calibration.belief_design(*rng.normal(size=(4, 40_000)))
    wanted = np.array([-0.5, 1.0, 0.3, -0.7, 0.2])
    correct = rng.random(len(inputs)) < calibration.logistic(inputs @ wanted)
    np.testing.assert_allclose(calibration.fit(inputs, correct), wanted, atol=0.05)


@pytest.mark.parametrize("outcome", [True, False])
def test_fit_refuses_what_is_always_right_or_wrong(outcome):
    with pytest.raises(ValueError, match="needs right and wrong matches; simulate more routes"):
        calibration.fit(np.ones((9, 2)), np.full(9, outcome))


# ---- the script --------------------------------------------------------------------------


@pytest.mark.parametrize("statistic", STATISTICS)
def test_samples_are_those_of_single_routes_before_calibration(script, statistic):
    banks = [random_bank(1), random_bank(2, techniques=2, queries=25, references=40)]
    inputs, correct = script.collect(banks, statistic, 50, lambda: np.ones((2, 3), np.bool_))
    expected, right = [], []
    for bank in banks:  # the samples go frame by frame, the routes in turn
        env = TechniqueSelectionEnv(bank, statistic=statistic)
        env.reset(seed=0)
        samples = []
        for frame in range(bank.queries):
            info = env.step(np.ones(len(bank.techniques)))[4]
            known = env.task.episodes.state.routes[0]
            discount = env.task.episodes.state.slots[0]["discount"][info["technique"]]
            sample = [info["confidence"], discount, known["track"], known["on_map"]]
            sample += [known["heard"], known["support"], info["margin"]]
            if statistic == "belief":
                belief = env.task.episodes.estimator.state.beliefs[0, 0]
                share = log_odds(belief["share"])
                sample = [share, info["margin"], known["log_likelihood"]]
                sample += [known["log_likelihood_mean"], known["on_map"]]
            samples.append(sample)
            right.append((frame, len(expected), abs(info["prediction"] - frame) <= 2))
        expected.append(samples)
    order = sorted(
        (frame, route) for route, own in enumerate(expected) for frame in range(len(own))
    )
    np.testing.assert_allclose(inputs, [expected[route][frame] for frame, route in order])
    assert correct.tolist() == [correctness for _, _, correctness in sorted(right)]


def test_script_fits_frames_with_a_rival_and_those_without_apart(script):
    rng = np.random.default_rng(4)
    inputs = rng.uniform(0.0, 2.0, (60_000, 7))  # in the order of SIC_INPUTS
    names = ("confidence", "discount", "track", "on_map", "heard", "support", "margin")
    assert names == script.SIC_INPUTS
    lonely = rng.random(len(inputs)) < 0.5
    inputs[lonely, 6] = 0.0  # no rival, no margin
    wanted, alone, late = [-1.0, 0.5, 0.3, -0.6, 0.8, 0.7], [-1.5, 0.9, 0.4], [-0.5, 2.0]
    confidence, discount, tens, on_map, heard, support, margin = inputs.T
    s, t = np.arcsinh(confidence * discount), np.log(1 + 10 * tens)
    columns = [np.ones_like(s), s, t, heard, support, np.arcsinh(margin)]
    logits = np.where(lonely, alone @ np.stack(columns[:3]), wanted @ np.stack(columns))
    p = calibration.logistic(logits) * calibration.logistic(late[0] + late[1] * on_map)
    samples = (inputs, rng.random(len(inputs)) < p)
    np.testing.assert_allclose(script.sic_fit(samples, rival=True), wanted + late, atol=0.4)
    np.testing.assert_allclose(script.sic_fit(samples, rival=False), alone + late, atol=0.4)


def test_script_fits_every_statistic(script, tmp_path, capsys):
    out = tmp_path / "calibration.json"
    script.main(["--routes", "8", "--seed", "3", "--out", str(out)])
    table = json.loads(out.read_text("utf-8"))
    assert table["made_by"] == "python scripts/calibrate.py --routes 8 --seed 3"
    shipped = calibration.stored()["coefficients"]
    assert table["coefficients"].keys() == shipped.keys() == set(STATISTICS)
    for statistic, parts in table["coefficients"].items():
        sizes = {name: len(numbers) for name, numbers in parts.items()}
        assert sizes == {name: len(numbers) for name, numbers in shipped[statistic].items()}
    printed = capsys.readouterr().out
    assert all(statistic in printed for statistic in STATISTICS)
