"""scripts/results.py on recordings of a few images."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.documents import BLOCK, altered
from amusic_gym.evaluation.study import rivals

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parent.parent / "scripts"
DOCUMENT = "".join(
    f"<!-- made by: scripts/results.py {kind} -->\n<!-- end -->\n\n"
    for kind in ("tours", "recorded", "motions")
)


@pytest.fixture
def results(monkeypatch, tmp_path):
    """The script's module on three recordings of 12 images, with one draw."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import _recordings
    import results

    rng = np.random.default_rng(0)
    for pair in _recordings.FOLDERS.values():
        for folder in pair:
            (tmp_path / "data" / folder).mkdir(parents=True)
            for i in range(12):
                image = rng.integers(0, 256, (32, 32, 3), np.uint8)
                cv2.imwrite(str(tmp_path / "data" / folder / f"{i:02d}.png"), image)
    monkeypatch.setattr(_recordings, "TECHNIQUES", ("hog", "cohog"))
    tours = {7: (("corridor", None), ("nordland", range(1, 11, 2))), 8: (("gardens", None),)}
    monkeypatch.setattr(_recordings, "TOURS", tours)
    monkeypatch.setattr(_recordings, "RECORDED", (("corridor", None), ("nordland", range(2, 9))))
    monkeypatch.setattr(rivals, "DRAWS", 1)
    monkeypatch.setattr(rivals, "COMPUTE_WEIGHTS", (0.1, 1.0))
    few = ["amusic", "cascade", "voi:idle", "oracle"]
    for kind, study in results.STUDIES.items():
        how = {**study.how, "draws": 1}
        monkeypatch.setitem(
            results.STUDIES, kind, replace(study, rules=lambda techniques: few, how=how)
        )
    monkeypatch.setattr(results, "peers", lambda techniques: ["hmm", "hmm:0.3/0.02"])
    monkeypatch.setenv("AMUSIC_DATA", str(tmp_path / "data"))
    return results


@pytest.fixture
def docs(tmp_path):
    """Documents with room for every kind."""
    folder = tmp_path / "docs"
    folder.mkdir()
    for name in ("results.md", "leaderboard.md"):
        (folder / name).write_text(f"# {name}\n\n{DOCUMENT}")
    return folder


def call(results, monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["results.py", *map(str, words), "--costs", "runs"])
    results.main()


def test_one_command_makes_the_banks_and_every_table(results, monkeypatch, tmp_path, docs, capsys):
    out = tmp_path / "out"
    yours = ("--policy", "random:0.4", "--selector", "mine=ppo")
    call(results, monkeypatch, "all", "--out", out, "--docs", docs, *yours)
    banks = {path.name: ScoreBank.load(path) for path in (out / "banks").iterdir()}
    frames = {"tour-7": 17, "tour-8": 12, "corridor": 12, "nordland": 7}
    assert {name: bank.queries for name, bank in banks.items()} == frames
    assert all(bank.tolerance == 2 for bank in banks.values())
    printed = capsys.readouterr().out
    title = "### The best of each kind at no more compute, {}: mean over {} routes"
    assert printed.count(title.format("as recorded", 2)) == 2
    assert all(title.format(words, 4) in printed for words in ("paced", "kidnapped"))
    for name in ("results.md", "leaderboard.md"):
        text = (docs / name).read_text("utf-8")
        assert altered(text) == []
        for part in BLOCK.finditer(text):  # what stands there is what the command said
            assert part["text"].strip() in printed
    board = (docs / "leaderboard.md").read_text("utf-8")
    assert board.count("\n| ships † |") == board.count("\n| mine † |") == 5
    assert board.count("\n| hmm |") == 5  # one row for all its settings
    assert board.count("\n| random |") == 5
    for kind in results.STUDIES:
        assert (out / kind / "runs" / "tables.md").is_file()
        picture = (out / kind / "runs" / "fronts.png").read_bytes()
        assert (docs / "images" / f"{kind}.png").read_bytes() == picture


def test_a_kind_alone_leaves_the_others_tables(results, monkeypatch, tmp_path, docs):
    call(results, monkeypatch, "tours", "--out", tmp_path / "out", "--docs", docs)
    assert altered((docs / "results.md").read_text("utf-8")) == [
        f"scripts/results.py {kind}" for kind in ("recorded", "motions")
    ]


def test_says_what_is_missing(results, monkeypatch, tmp_path, docs):
    (docs / "results.md").write_text("nothing")
    words = ("recorded", "--out", tmp_path / "out")
    with pytest.raises(ValueError, match=r"results\.md: the document has 0 blocks made by"):
        call(results, monkeypatch, *words, "--docs", docs)
    monkeypatch.delenv("AMUSIC_DATA")
    with pytest.raises(ValueError, match="AMUSIC_DATA names no folder"):
        call(results, monkeypatch, *words)
