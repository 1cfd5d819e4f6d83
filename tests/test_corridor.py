"""The numbers that the real Corridor recording must give, by the package from end to end."""

from __future__ import annotations

from typing import Any

import corridor
import numpy as np
import pytest

from amusic_gym import correctness
from amusic_gym.bank import ScoreBank
from amusic_gym.metrics import summarise
from amusic_gym.policy import Context
from amusic_gym.rollout import rollout
from amusic_gym.trace import Trace
from baselines import make_policy


def load(names: tuple[str, ...] = corridor.TECHNIQUES) -> ScoreBank:
    scores, techniques, seconds, truth = corridor.load(names)
    return ScoreBank(scores, techniques, seconds, ground_truth=truth, name="corridor")


@pytest.fixture(scope="module")
def recording() -> ScoreBank:
    return load()


FITTED_WITHOUT = pytest.mark.xfail(
    strict=True, reason="p̂ of evidence was fitted without carried candidates and the discount"
)
PLAIN: dict[str, Any] = {"carry": False, "discount": False}


def run(bank: ScoreBank, policy: str, statistic: str, **how: Any) -> Trace:
    made = make_policy(policy, Context.of(bank, statistic=statistic, **how))
    return rollout(made, bank, name=policy, statistic=statistic, **how)


@pytest.mark.parametrize(("policy", "statistic"), corridor.EXPECTED)
def test_table(recording: ScoreBank, policy: str, statistic: str) -> None:
    trace = run(recording, policy, statistic, **PLAIN)
    row = {**summarise(trace), "runs": int(trace.runs.sum())}
    assert set(corridor.COLUMNS) <= row.keys()
    assert corridor.differences(policy, statistic, row) == []


def test_cheap_pair_is_nearly_as_good_as_everything(recording: ScoreBank) -> None:
    row = summarise(run(recording, "subset:HOG+CALC", "evidence"))
    assert f"{row['auc']:.3f} {row['compute']:.3f}" == "0.991 0.022"


def test_oracle_is_right_wherever_a_technique_is(recording: ScoreBank) -> None:
    row = summarise(run(recording, "oracle", "evidence"))
    assert row["accuracy"] == 1.0
    assert row["ptr"] == 0.25
    assert row["compute"] < 0.02


@pytest.mark.parametrize("how", [PLAIN, pytest.param({}, marks=FITTED_WITHOUT)])
def test_estimated_correctness_of_ten_techniques_run_singly(how: dict[str, Any]) -> None:
    folder = corridor.data_folder() / "corridor" / "scores"
    names = tuple(sorted(path.stem for path in folder.glob("*.npy")))
    assert len(names) == 10
    bank = load(names)
    traces = [run(bank, f"single:{name}", "evidence", **how) for name in names]
    report = correctness.assess(traces)
    pooled = report["pooled"]
    assert pooled["frames"] == 10 * bank.queries
    assert pooled["auroc"] >= 0.95
    assert pooled["brier"] < pooled["brier_of_accuracy"]
    assert report["within"]["auroc"] > 0.8


def test_paper_and_run_costs_change_compute_only(recording: ScoreBank) -> None:
    rows = {
        costs: summarise(run(recording.with_costs(costs), "amusic", "mean"))
        for costs in ("measured", "paper", "runs")
    }
    assert len({(row["accuracy"], row["auc"], row["ptr"]) for row in rows.values()}) == 1
    assert np.isclose(rows["runs"]["compute"], rows["runs"]["ptr"])
    assert len({row["compute"] for row in rows.values()}) == 3
