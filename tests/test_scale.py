"""scripts/scale.py runs on tiny sizes, goes on where it was, and measures what it says."""

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


@pytest.fixture
def shortlist(scale):
    return importlib.import_module("_scale_shortlist")


def run(scale, monkeypatch, capsys, out: Path) -> str:
    monkeypatch.setattr(sys, "argv", ["scale.py", "--quick", "--out", str(out)])
    scale.main()
    return capsys.readouterr().out


def test_tiny_sizes_make_every_table_and_nothing_twice(scale, monkeypatch, tmp_path, capsys):
    first = run(scale, monkeypatch, capsys, tmp_path)
    written = (tmp_path / "tables.md").read_text("utf-8")
    assert first.strip() == written.strip()
    titles = [line for line in written.splitlines() if line.startswith("### ")]
    assert len(titles) == 8
    assert len({len(line.split("|")) for line in written.splitlines() if " 20% |" in line}) == 1

    def forbidden(*arguments):
        raise AssertionError("measured again")

    for name in ("drive", "match", "search", "driven"):
        monkeypatch.setattr(scale, name, forbidden)
    assert run(scale, monkeypatch, capsys, tmp_path) == first
    next((tmp_path / "cells").iterdir()).unlink()
    with pytest.raises(AssertionError, match="measured again"):
        run(scale, monkeypatch, capsys, tmp_path)


def test_a_shortlist_keeps_the_best_of_every_row(shortlist):
    bank = random_bank(3, queries=5, references=40, levels=1000)
    scores = bank.scores
    for fill in shortlist.FILLS:
        left = shortlist.shortened(bank, 0.1, fill).scores
        for now, row in zip(left.reshape(-1, 40), scores.reshape(-1, 40), strict=True):
            best = np.argsort(-row, kind="stable")[:4]
            rest = np.setdiff1d(np.arange(40), best)
            assert (now[best] == row[best]).all()
            given = {"floor": row[best[-1]], "mean": row.mean(), "none": -np.inf}[fill]
            assert now[rest] == pytest.approx(np.full(36, given))
    assert (bank.scores == scores).all()


def test_an_index_that_searches_all_lists_is_exact_and_fewer_find_fewer(shortlist):
    descriptors, truth, seen = shortlist.route_of(2000, 40)
    index = shortlist.NumpyIndex(descriptors, 16)
    assert sorted(index.places.tolist()) == list(range(2000))
    found = {lists: [] for lists in (1, 4, 16)}
    for query in seen[0.9]:
        exact = set(np.argsort(-(descriptors @ query), kind="stable")[:50].tolist())
        for lists, shares in found.items():
            places = set(index.search(query, lists).tolist())
            assert len(places) <= 50
            shares.append(len(places & exact) / 50)
    means = [np.mean(shares) for shares in found.values()]
    assert means[2] == 1.0
    assert 0.2 < means[0] < means[1] < means[2]


def test_faiss_agrees_with_numpy_when_all_lists_are_searched(shortlist):
    faiss = pytest.importorskip("faiss", reason="pip install faiss-cpu")
    descriptors, _, seen = shortlist.route_of(2000, 5)
    both = shortlist.FaissIndex(descriptors, 16, faiss), shortlist.NumpyIndex(descriptors, 16)
    for query in seen[0.9]:
        ours, theirs = (set(one.search(query, 16).tolist()) for one in both)
        assert len(ours & theirs) >= 49  # the last place may differ by rounding


def test_memory_of_a_drive_is_one_sum_per_technique_and_place(scale):
    few, many = (scale.drive("evidence", places, 2, 1, 30)["mib"] for places in (2_000, 20_000))
    assert 7 < (many - few) * 2**20 / (18_000 * 2) < 9
