"""The demo's own parts, and the whole of it on routes of a minute's size."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path

import pytest

from agents.config import TrainingConfig
from agents.network import NetworkConfig
from amusic_gym.routes.simulate import planted, simulate

SCRIPTS = Path(__file__).parent.parent / "scripts"


def row(policy: str, auc: float, compute: float, weight: float | None = None) -> dict:
    return {"policy": policy, "auc": auc, "compute": compute, "compute_weight": weight}


ROWS = [
    row("amusic", 0.80, 0.40),
    row("music", 0.90, 1.0),
    row("single:HOG", 0.50, 0.10),
    row("subset:A+B", 0.70, 0.30),
    row("subset:A+C", 0.85, 0.60),
    row("ppo:run", 0.88, 0.35, 0.2),
    row("ppo:run", 0.91, 0.70, 0.05),
]


@pytest.fixture
def scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))


def test_story_compares_at_no_more_compute(scripts):
    import _demo_story as story

    assert story.best_within(ROWS, "s", 0.4)["policy"] == "subset:A+B"
    assert story.best_within(ROWS, "s", 0.05) is None
    said = " ".join(story.held_out(ROWS, 4))
    assert "reaches AUC 0.880 at 35%" in said
    assert "A-MuSIC itself 0.800 at 40%" in said
    assert "(subset:A+B) 0.700" in said
    assert "0.850" not in said  # dearer than A-MuSIC
    assert "best is 0.910, at 70%" in said


def test_story_of_a_recording_without_a_cheap_row_takes_the_cheapest(scripts):
    import _demo_story as story

    assert "AUC 0.880 at 35.0% compute (λ 0.2)" in story.other("mine", ROWS)


def test_demo_from_routes_to_page(scripts, monkeypatch, tmp_path, capsys):
    import _demo_drive
    import _demo_images
    import demo

    small = partial(
        TrainingConfig,
        n_envs=4,
        n_steps=16,
        batch_size=64,
        pool=4,
        held_out=2,
        network=NetworkConfig(hidden=8, encoding=4),
    )
    routes = {"frames_per_regime": 20, "references": 100, "techniques": 2}
    monkeypatch.setattr(demo, "TrainingConfig", small)
    monkeypatch.setattr(_demo_images, "PLACES", 8)
    monkeypatch.setattr(_demo_images, "TECHNIQUES", ("hog", "cohog"))
    drives = [_demo_images.Drives("corridor", 1, ("day", "night"))]
    monkeypatch.setattr(_demo_images, "DRIVES", drives)
    monkeypatch.setattr(_demo_drive, "SHOWN", 3)
    monkeypatch.setattr(demo, "planted", partial(planted, **routes))
    monkeypatch.delenv("AMUSIC_DATA", raising=False)
    own = simulate(5, queries=30, techniques=3).save(tmp_path / "own")
    arguments = ["--out", str(tmp_path / "out"), "--timesteps", "128", "--bank", str(own)]
    monkeypatch.setattr(sys, "argv", ["demo.py", *arguments])
    demo.main()
    out = capsys.readouterr().out
    assert "rendered routes that no training saw" in out or "Running every technique" in out
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["rows"]
    assert {r["bank"] for r in rows} == {"corridor-day", "corridor-night", "planted", "simulated-5"}
    assert {"amusic", "music", "cascade", "single:HOG", "random:0.3"} <= {r["policy"] for r in rows}
    page = (tmp_path / "out" / "index.html").read_text()
    assert "data:image/png;base64" in page
    assert "data:image/jpeg;base64" in page  # the contact sheet
    assert (tmp_path / "out" / "drive.png").is_file()
    assert (tmp_path / "out" / "drive.mp4").stat().st_size > 1000
    assert "http://" not in page  # self-contained: it loads nothing
    assert "https://" not in page
    assert (tmp_path / "out" / "run" / "selector.safetensors").is_file()
