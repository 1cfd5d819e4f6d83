"""scripts/scale.py runs on tiny sizes and measures what it says."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from env_cases import random_bank

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture
def scale(monkeypatch):
    """The script, imported."""
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module("scale")


def test_tiny_sizes_make_every_table(scale, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sys, "argv", ["scale.py", "--quick", "--out", str(tmp_path)])
    scale.main()
    written = (tmp_path / "tables.md").read_text("utf-8")
    assert capsys.readouterr().out.strip() == written.strip()
    titles = [line for line in written.splitlines() if line.startswith("### ")]
    assert len(titles) == 7
    assert len({len(line.split("|")) for line in written.splitlines() if " 20% |" in line}) == 1


def test_a_shortlist_keeps_the_best_of_every_row(scale):
    bank = random_bank(3, queries=5, references=40, levels=1000)
    scores = bank.scores
    for fill in scale.FILLS:
        left = scale.shortened(bank, 0.1, fill).scores
        for now, row in zip(left.reshape(-1, 40), scores.reshape(-1, 40), strict=True):
            best = np.argsort(-row, kind="stable")[:4]
            rest = np.setdiff1d(np.arange(40), best)
            assert (now[best] == row[best]).all()
            given = {"floor": row[best[-1]], "mean": row.mean(), "none": -np.inf}[fill]
            assert now[rest] == pytest.approx(np.full(36, given))
    assert (bank.scores == scores).all()


def test_memory_of_a_drive_is_one_sum_per_technique_and_place(scale):
    few, many = (scale.step_of("evidence", places, 2, 1, 30)["mib"] for places in (2_000, 20_000))
    assert 7 < (many - few) * 2**20 / (18_000 * 2) < 9
