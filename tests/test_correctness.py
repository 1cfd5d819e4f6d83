"""The report on estimated correctness, worked out by hand."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from env_cases import random_bank

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.audit import audit, held
from amusic_gym.evaluation.correctness import MEASURES, assess, table
from amusic_gym.policies.trace import Trace
from amusic_gym.routes.retime import retime

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture
def script(monkeypatch):
    """Imports one of the scripts' modules."""
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module


def trace(technique: str, right: list[int], estimates: list[float] | None) -> Trace:
    """A trace that is right where `right` says so."""
    frames = len(right)
    bank = ScoreBank(
        np.zeros((1, frames, 9)),
        [technique],
        [1.0],
        tolerance=0,
        name="route",
        ground_truth=np.arange(frames),
    )
    predictions = [q if on else 8 for q, on in enumerate(right)]
    return Trace.join(
        bank,
        predictions=predictions,
        confidence=np.zeros(frames),
        similarity=np.zeros(frames),
        ran=np.ones((frames, 1), bool),
        p_correct=estimates,
        policy=f"single:{technique}",
        statistic="evidence",
    )


def test_pooled_and_within_each_technique():
    sure = trace("A", [1, 1, 1, 1], [0.9, 0.8, 1.0, 0.9])
    mixed = trace("B", [1, 0, 1, 0], [0.6, 0.7, 0.8, 0.1])
    report = assess([sure, mixed])
    a, b = report["techniques"]
    assert [a["technique"], b["technique"]] == ["A", "B"]
    assert a["auroc"] is None
    assert b["auroc"] == 3 / 4  # 0.6 > 0.1, 0.8 > 0.7, 0.8 > 0.1, not 0.6 > 0.7
    assert report["within"] == {"auroc": 3 / 4, "least_auroc": 3 / 4, "techniques": 1}
    assert a["brier"] == pytest.approx((0.01 + 0.04 + 0 + 0.01) / 4)
    assert (a["brier_of_accuracy"], b["brier_of_accuracy"]) == (0.0, 0.25)
    pooled = report["pooled"]
    assert (pooled["frames"], pooled["accuracy"]) == (8, 0.75)
    assert pooled["auroc"] == 11 / 12
    assert pooled["brier"] == pytest.approx((a["brier"] + b["brier"]) / 2)
    assert pooled["brier_of_accuracy"] == 0.125
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_table_names_every_technique_and_measure():
    text = table(assess([trace("A", [1, 1], [0.9, 0.8]), trace("B", [1, 0], [0.6, 0.7])]))
    lines = text.splitlines()
    assert len(lines) == 4
    assert all(name.replace("_", " ") in lines[0] for name in MEASURES)
    assert lines[1].split()[:5] == ["route", "A", "2", "1.0000", "-"]
    assert lines[3].split()[:2] == ["pooled", "4"]


def test_traces_without_estimates_are_refused():
    with pytest.raises(ValueError, match="single:A on bank 'route' has no estimated correctness"):
        assess([trace("A", [1], None)])
    with pytest.raises(ValueError, match="no trace to assess"):
        assess([])


def test_audit_pools_the_frames_of_its_traces():
    traces = [trace("A", [1, 0, 1], [0.9, 0.2, np.nan]), trace("B", [0], [0.3])]
    correct, estimate = held(*traces)
    assert correct.tolist() == [True, False, False]
    assert estimate.tolist() == [0.9, 0.2, 0.3]
    pooled = audit(*traces, bins=2)
    assert pooled is not None
    assert (pooled.accuracy, pooled.auroc) == (1 / 3, 1.0)
    assert pooled.p_correct == pytest.approx(1.4 / 3)
    assert pooled.calibration_error == pytest.approx(0.1 / 3 + 0.25 * 2 / 3)
    coarse = audit(*traces, bins=1)
    assert coarse is not None
    assert coarse.calibration_error == pytest.approx((1.4 - 1) / 3)


def two_timings() -> list:
    """Drives of banks "a" and "b", numbers to work out by hand."""

    def made(correct, estimates):
        route = ScoreBank(
            np.zeros((1, len(correct), 9)),
            ["A"],
            [1.0],
            tolerance=0,
            ground_truth=np.arange(len(correct)),
        )
        return Trace.join(
            route,
            predictions=[q if on else 8 for q, on in enumerate(correct)],
            confidence=np.zeros(len(correct)),
            similarity=np.zeros(len(correct)),
            ran=np.ones((len(correct), 1), bool),
            p_correct=estimates,
            policy="random:0.6",
            statistic="evidence",
        )

    recorded, retimed = "as recorded", "re-timed"
    a = {
        recorded: [made([1, 0], [0.8, 0.4]), made([1, 0], [0.62, 0.68])],
        retimed: [made([0, 0], [0.2, 0.1])],
    }
    return [("a", a), ("b", {recorded: [made([1], [1.0])], retimed: [made([1], [0.9])]})]


def test_random_activity_per_bank_and_pooled(script):
    report = script("correctness").held_against_truth(two_timings())
    fused = {(row["bank"], row["timing"]): row for row in report["fused"]}
    assert list(fused) == [
        (bank, timing) for bank in ("a", "b", "pooled") for timing in ("as recorded", "re-timed")
    ]
    a = fused["a", "as recorded"]
    assert (a["drives"], a["frames"], a["accuracy"]) == (2, 4, 0.5)
    assert a["p_correct"] == pytest.approx(2.5 / 4)
    assert a["auroc"] == 3 / 4  # 0.8 above 0.4 and 0.68, 0.62 above 0.4 only
    assert a["brier"] == pytest.approx((0.04 + 0.16 + 0.38**2 + 0.68**2) / 4)
    assert a["calibration_error"] == pytest.approx((0.2 + 0.4 + 2 * 0.15) / 4)  # two in a bin
    assert (a["right_of_sure"], a["sure_of_away"]) == (None, None)  # 0.8 is not sure
    assert fused["b", "as recorded"]["right_of_sure"] == 1.0
    assert fused["a", "re-timed"]["auroc"] is None
    pooled = fused["pooled", "re-timed"]
    assert (pooled["drives"], pooled["frames"], pooled["auroc"]) == (2, 3, 1.0)
    assert pooled["brier"] == pytest.approx((0.04 + 0.01 + 0.01) / 3)
    curve = report["reliability"]["re-timed"]
    assert curve["counts"] == [0, 1, 1, 0, 0, 0, 0, 0, 0, 1]
    assert curve["predicted"][:3] == [None, 0.1, 0.2]
    assert curve["observed"][9] == 1.0
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_being_sure_where_no_place_is_true_has_a_column_of_its_own(script):
    module, truth = script("correctness"), np.eye(4, 9, dtype=bool)
    truth[2:] = False
    bank = ScoreBank(np.zeros((1, 4, 9)), ["A"], [1.0], tolerance=0, ground_truth=truth)
    trace = Trace.join(
        bank,
        predictions=np.arange(4),
        confidence=np.zeros(4),
        similarity=np.zeros(4),
        ran=np.ones((4, 1), bool),
        p_correct=[0.95, 0.5, 0.9, 0.2],
        policy="music",
        statistic="evidence",
    )
    (row, _) = module.held_against_truth([("a", {"as recorded": [trace]})])["fused"]
    assert (row["right_of_sure"], row["sure_of_away"]) == (0.5, 0.5)


def test_the_table_of_random_activity_is_markdown(script):
    module = script("correctness")
    table = module.table_of(module.held_against_truth(two_timings()))
    lines = table.markdown().splitlines()
    assert "| bank | drive | frames | right | mean p̂ | AUROC |" in lines[2]
    assert lines[4] == "| a | as recorded | 4 | 0.500 | 0.625 | 0.750 | 0.225 | 0.202 | - | - |"
    assert lines[5].startswith("| a | re-timed | 2 | 0.000 | 0.150 | - |")
    assert lines[8].startswith("| pooled | as recorded | 5 |")


def test_random_drives_are_as_recorded_and_re_timed_with_the_same_activity(script):
    module, bank = script("correctness"), random_bank(3, queries=30)
    groups = module.random_drives(bank, "evidence", 4)
    assert {timing: len(traces) for timing, traces in groups.items()} == {
        "as recorded": 4,
        "re-timed": 4,
    }
    recorded, retimed = groups.values()
    rates = {float(trace.policy.partition(":")[2]) for trace in recorded}
    assert rates <= set(module.RATES)
    assert len(rates) > 1
    for seed, (one, other) in enumerate(zip(recorded, retimed, strict=True)):
        for trace, route in ((one, bank), (other, retime(bank, seed))):
            assert np.array_equal(trace.correct, route.truth.correct(trace.predictions))
            assert trace.ran.any(axis=1).all()
        assert np.array_equal(one.ran, other.ran)
    ((only,),) = module.random_drives(bank, "evidence", 0).values()
    assert np.array_equal(only.predictions, recorded[0].predictions)


def test_the_script_writes_tables_numbers_and_figures(script, monkeypatch, tmp_path, capsys):
    bank = random_bank(3, queries=30).save(tmp_path / "bank")
    words = ["correctness.py", "--bank", bank, "--out", tmp_path / "out", "--retimed", "2"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    script("correctness").main()
    out = capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "correctness.json", "reliability.png", "reliability_random.png", "tables.md",
    ]  # fmt: skip
    assert (tmp_path / "out" / "tables.md").read_text("utf-8") in out
    random = json.loads((tmp_path / "out" / "correctness.json").read_text("utf-8"))["random"]
    assert [row["frames"] for row in random["fused"]] == [60, 60, 60, 60]
    monkeypatch.setattr(sys, "argv", [*sys.argv[:-1], "-1"])
    with pytest.raises(ValueError, match="--retimed is -1; give a whole number >= 0"):
        script("correctness").main()
