"""Estimated correctness: the compiled p̂ against the documented formula, the fit, the script."""

from __future__ import annotations

import importlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from env_cases import random_actions, random_bank

from amusic_gym import calibration
from amusic_gym.env import TechniqueSelectionEnv
from amusic_gym.settings import STATISTICS

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
    assert shipped.shape == ((5,) if statistic == "belief" else (9,))
    assert np.isfinite(shipped).all()
    surer = [1] if statistic == "belief" else [3, 4, 6]  # support, margin, statistic alone
    assert (shipped[surer] > 0.0).all()  # the surer, the righter


def test_the_estimate_of_the_belief_is_the_documented_one(bank):
    b = calibration.coefficients("belief")
    env = TechniqueSelectionEnv(bank, statistic="belief", allow_idle=True)
    env.reset(seed=0)
    said_mean, seen = 0.0, set()
    for action in random_actions(5, 40, (3,), reselect=0.5):
        info = env.step(action)[4]
        if info["prediction"] < 0:
            continue
        mind = env.task.episodes.minds.minds[0, 0]
        if info["ran"].any():
            said_mean += 0.2 * (mind["said"] / info["ran"].sum() - said_mean)
        ratio = log_ratio(mind["share"], mind["rival"])
        assert info["margin"] == pytest.approx(ratio)
        logit = b[0] + b[1] * log_odds(mind["share"]) + b[2] * ratio
        logit += b[3] * mind["said"] + b[4] * said_mean
        assert info["confidence"] == pytest.approx(logit)
        assert info["p_correct"] == pytest.approx(1.0 / (1.0 + math.exp(-logit)))
        inputs = calibration.belief_design(log_odds(mind["share"]), ratio, mind["said"], said_mean)
        assert calibration.logistic(inputs @ b) == pytest.approx(info["p_correct"])
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
            statistic_ = info["confidence"] * known.slots[0]["discount"][info["technique"]]
            margin = [info["margin"]] if rival else None
            support = known.routes[0]["support"]
            inputs = calibration.design([statistic_], [track], [support], margin)
            part = b[:5] if rival else b[5:]
            assert calibration.logistic(inputs @ part)[0] == pytest.approx(info["p_correct"])
            seen.add((rival, round(info["p_correct"], 6)))
    assert min(sum(one[0] == rival for one in seen) for rival in (True, False)) >= 5


def test_design_compresses_what_sic_gives():
    found = calibration.design([0.0, 2.0], [0, 7], [0.0, 0.5], [1.0, -3.0])
    expected = [
        [1, 0, 0, 0, math.asinh(1)],
        [1, math.asinh(2), math.log(8), 0.5, math.asinh(-3)],
    ]
    np.testing.assert_allclose(found, expected)
    np.testing.assert_allclose(calibration.design([2.0], [7], [0.5], None), [expected[1][:4]])


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
            mind = env.task.episodes.minds.minds[0, 0]
            known = env.task.episodes.state.routes[0]
            discount = env.task.episodes.state.slots[0]["discount"][info["technique"]]
            sample = [info["confidence"], discount, known["track"], known["support"]]
            sample.append(info["margin"])
            if statistic == "belief":
                share = log_odds(mind["share"])
                sample = [share, info["margin"], known["said"], known["said_mean"]]
            samples.append(sample)
            right.append((frame, len(expected), abs(info["prediction"] - frame) <= 2))
        expected.append(samples)
    order = sorted(
        (frame, route) for route, own in enumerate(expected) for frame in range(len(own))
    )
    np.testing.assert_allclose(inputs, [expected[route][frame] for frame, route in order])
    assert correct.tolist() == [correctness for _, _, correctness in sorted(right)]


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
