"""scripts/results.py on recordings of a few images."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.study import rivals

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture
def results(monkeypatch, tmp_path):
    """The script's module on three recordings of 12 images, with one draw."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import results

    rng = np.random.default_rng(0)
    for pair in results.FOLDERS.values():
        for folder in pair:
            (tmp_path / "data" / folder).mkdir(parents=True)
            for i in range(12):
                image = rng.integers(0, 256, (32, 32, 3), np.uint8)
                cv2.imwrite(str(tmp_path / "data" / folder / f"{i:02d}.png"), image)
    monkeypatch.setattr(results, "TECHNIQUES", ("hog", "cohog"))
    tours = {7: (("corridor", None), ("nordland", range(1, 11, 2))), 8: (("gardens", None),)}
    monkeypatch.setattr(results, "TOURS", tours)
    monkeypatch.setattr(results, "RECORDED", (("corridor", None), ("nordland", range(2, 9))))
    monkeypatch.setattr(rivals, "DRAWS", 1)
    monkeypatch.setattr(rivals, "COMPUTE_WEIGHTS", (0.1, 1.0))
    monkeypatch.setattr(rivals, "rivals", lambda techniques: ["amusic", "cascade", "voi:idle"])
    monkeypatch.setenv("AMUSIC_DATA", str(tmp_path / "data"))
    return results


@pytest.mark.parametrize(
    ("kind", "frames"),
    [("tours", {"tour-7": 17, "tour-8": 12}), ("recorded", {"corridor": 12, "nordland": 7})],
)
def test_makes_the_banks_and_prints_the_table(results, monkeypatch, tmp_path, capsys, kind, frames):
    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", ["results.py", kind, "--out", str(out), "--costs", "runs"])
    results.main()
    banks = {path.name: ScoreBank.load(path) for path in (out / "banks").iterdir()}
    assert {name: bank.queries for name, bank in banks.items()} == frames
    assert all(bank.tolerance == 2 for bank in banks.values())
    printed = capsys.readouterr().out
    title = "### The best of each kind at no more compute, as recorded: mean over 2 routes"
    assert title in printed
    assert printed.count("| ships † |") == 2  # a line for each λ
    assert (out / "runs" / "tables.md").is_file()
    assert (out / "runs" / "fronts.png").is_file()


def test_says_what_is_missing(results, monkeypatch, tmp_path):
    monkeypatch.delenv("AMUSIC_DATA")
    monkeypatch.setattr(sys, "argv", ["results.py", "tours", "--out", str(tmp_path / "out")])
    with pytest.raises(ValueError, match="AMUSIC_DATA names no folder"):
        results.main()
