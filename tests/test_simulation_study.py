"""What the comparison of simulated routes with recordings measures."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest
from env_cases import random_bank

from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.estimation.sic.correction import SIC

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture
def study(monkeypatch):
    """``scripts/simulation_study.py``, imported."""
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module("simulation_study")


@pytest.mark.parametrize("statistic", ["mean", "evidence"])
def test_places_are_those_of_each_technique_by_itself(study, statistic):
    bank = random_bank(3, queries=30)
    for rows, places in zip(bank.scores, study.alone(bank, statistic), strict=True):
        sic = SIC(bank.references, SICSettings(statistic))
        assert places.tolist() == [sic.correct(row).place for row in rows]


@pytest.mark.parametrize("speed", [0.0, 0.5, 3.0, -1.0])
def test_a_drive_at_a_speed_meets_frames_of_the_recording(study, speed):
    bank = random_bank(2, techniques=2, queries=400)
    drive = study.driven(bank, speed, np.random.default_rng(1))
    assert drive.scores.shape == (2, study.FRAMES, bank.references)
    off = np.square(drive.scores[:, :, None] - bank.scores[:, None]).mean(axis=(0, 3))
    frames = off.argmin(axis=1)
    assert frames.tolist() == (frames[0] + np.floor(speed * np.arange(study.FRAMES))).tolist()
    assert [drive.truth.of(q).tolist() for q in (0, 99)] == [
        bank.truth.of(frames[q]).tolist() for q in (0, 99)
    ]


def test_every_technique_has_a_line_of_every_measure(study):
    rows = study.measure([random_bank(3, queries=30), random_bank(4, techniques=2)])
    assert list(rows) == ["bank3 T0", "bank3 T1", "bank3 T2", "bank4 T0", "bank4 T1"]
    for row in rows.values():
        assert set(study.MEASURES) <= row.keys()
        assert np.isfinite([row[f"accuracy_{statistic}"] for statistic in STATISTICS]).all()
