"""The report on estimated correctness, worked out by hand."""

from __future__ import annotations

import json

import numpy as np
import pytest

from amusic_gym.bank import ScoreBank
from amusic_gym.correctness import MEASURES, assess, table
from amusic_gym.trace import Trace


def trace(technique: str, right: list[int], estimates: list[float] | None) -> Trace:
    """A trace that is right where `right` says so."""
    frames = len(right)
    bank = ScoreBank(np.zeros((1, frames, 9)), [technique], [1.0], tolerance=0, name="route")
    predictions = [q if on else 8 for q, on in enumerate(right)]
    return Trace.join(
        bank,
        predictions=predictions,
        confidence=np.zeros(frames),
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
