"""The demo's own parts, and the whole of it on routes of a minute's size."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from amusic_agents.selector import load_selector

from amusic_gym.cli import demo, demo_tours, start
from amusic_gym.cli import demo_story as story
from amusic_gym.evaluation.study import rivals
from amusic_gym.routes.simulate import simulate

pytestmark = pytest.mark.slow


def row(policy: str, auc: float, compute: float, weight: float | None = None) -> dict:
    return {
        **{"policy": policy, "auc": auc, "compute": compute, "compute_weight": weight},
        **{"bank": "mean", "auc_interval": [auc - 0.01, auc + 0.01]},
    }


POINTS = [
    row("amusic", 0.80, 0.40),
    row("amusic:evidence", 0.85, 0.45),
    row("music", 0.90, 1.0),
    row("trained here", 0.7, 0.1, 1.0),
    row("trained here", 0.8801, 0.35, 0.2),
    row("trained here", 0.8804, 0.42, 0.1),
    row("trained here", 0.91, 0.70, 0.05),
]


def match(kind: str, rival: str, auc: float, ends: list[float] | None) -> dict:
    return {
        **{"bank": "mean", "policy": "trained here", "compute_weight": 0.2, "kind": kind},
        **{"rival": rival, "rival_weight": None, "rival_auc": auc, "rival_compute": 0.3},
        **{"difference": 0.8801 - auc, "difference_interval": ends},
    }


MATCHES = [
    match("fixed subsets", "subset:A+B", 0.7, [0.1, 0.25]),
    match("random", "random:0.3", 0.6, [0.2, 0.3]),
    match("cascade", "cascade:1/9/0.5", 0.87, [-0.02, 0.03]),
    match("periodic", "periodic:2", 0.9, [-0.03, -0.01]),
    match("may idle", "voi:idle", 0.6, None),
    {**match("value of information", "voi", 0.0, None), "rival": None},
]
FINDINGS = SimpleNamespace(
    points=POINTS,
    matches=MATCHES,
    routes=[{}, {}],
    settings={"seeds": [0, 1, 2]},
    audit=[
        {"front": "random", "greatest_gap": 0.2},
        {"front": "random", "greatest_gap": 0.3},
        {"front": "cascade", "greatest_gap": 0.05},
    ],
)


def test_best_within_takes_the_cheaper_of_equals_and_else_the_cheapest():
    own = [each for each in POINTS if each["policy"] == "trained here"]
    assert story.best_within(own, 0.45)["compute"] == 0.35  # .8801 and .8804 are both .880
    assert story.best_within(own, 1.0)["compute"] == 0.70
    assert story.best_within(own, 0.01)["compute"] == 0.1
    near = [{"auc": 0.974, "compute": 0.57}, {"auc": 0.9695, "compute": 0.37}]
    assert story.best_within(near, 1.0) == near[1]
    assert story.best_within([{**near[1], "auc": 0.968}, near[0]], 1.0) == near[0]


def test_story_says_who_is_ahead_level_and_behind():
    tale = story.on_tours(FINDINGS, {"trained here": "The selector"})
    lines = tale.sentences
    assert lines[0] == (
        "The selector, at λ 0.2, reaches AUC 0.880 (0.870 to 0.890) at 35% of the compute of all"
        " techniques; at no more it is ahead of A+B (0.700 at 30%), random, p = 0.3 (0.600 at 30%);"
        " level with cascade (1/9/0.5) (0.870 at 30%); behind all every 2 frames (0.900 at 30%); of"
        " rules that may run nothing, ahead of value of information, may idle (0.600 at 30%);"
        " A-MuSIC on the same statistic takes 45% for 0.850."
    )
    assert "A-MuSIC as in the paper: 0.800 at 40%" in lines[1]
    assert "the selector's statistic: 0.850 at 45%" in lines[1]
    assert "over 2 tours and 3 draws, of one training" in lines[1]
    assert lines[2] == (
        "Estimated correctness is too high by more than 0.1 on some tour for random: see the audit."
    )
    assert len(lines) == 3
    rivals = ["subset:A+B", "random:0.3", "cascade:1/9/0.5", "periodic:2", "voi:idle"]
    assert tale.rivals == rivals
    assert tale.weights == {"trained here": 0.2}
    assert [row[:2] for row in tale.table.rows] == [
        ["trained here, λ 0.2", verdict]
        for verdict in ("ahead of", "ahead of", "level with", "behind", "ahead of")
    ]
    assert "Level with: 0 is in the 95 % interval" in tale.table.note
    assert tale.table.rows[2][2:] == [
        *("cascade (1/9/0.5)", "cascade", "0.880", "0.870", "30.0%", "-0.020 to +0.030"),
    ]


def test_what_a_music_costs_is_told_only_where_it_is_no_rival():
    cheap = {**POINTS[1], "compute": 0.3}
    findings = SimpleNamespace(**{**vars(FINDINGS), "points": [POINTS[0], cheap, *POINTS[2:]]})
    (line, *_) = story.on_tours(findings, {"trained here": "The selector"}).sentences
    assert "at λ 1, reaches AUC 0.700" in line
    assert "takes" in line
    cheap["compute"] = 0.1
    (line, *_) = story.on_tours(findings, {"trained here": "The selector"}).sentences
    assert "takes" not in line


def test_another_recording_is_told_in_one_sentence():
    said = story.other("Hall", POINTS, "trained here")
    assert said == (
        "On Hall, which no training saw, trained here reaches AUC 0.880 at 35.0% of the compute"
        " (λ 0.2); A-MuSIC 0.800 at 40%, on the selector's statistic 0.850 at 45%."
    )


def test_highlights_are_drives_as_spoken_of_with_stops_and_one_that_fails():
    def drive(bank: str, policy: str, weight: float, accuracy: float) -> SimpleNamespace:
        correct = np.arange(10) < 10 * accuracy
        return SimpleNamespace(bank=bank, policy=policy, compute_weight=weight, correct=correct)

    traces = [
        drive("a", "own", 0.1, 0.9),
        drive("a", "own", 0.2, 0.7),
        drive("b", "own", 0.2, 0.2),
        drive("a", "other", 0.2, 0.0),
        drive("stops", "own", 0.2, 0.1),
        drive("stops", "ppo@belief", 0.1, 0.8),
    ]
    tale = SimpleNamespace(weights={"own": 0.2})
    found = story.highlights(traces, ["a", "b"], "stops", "own", tale)
    assert [(words, traces.index(trace)) for words, trace in found] == [
        ("as above, on a", 1),
        ("with stops", 4),
        ("with stops, by the belief", 5),
        ("one that fails: λ 0.2 on b", 2),
    ]


def test_demo_from_worlds_to_page(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(rivals, "DRAWS", 2)
    monkeypatch.setattr(rivals, "COMPUTE_WEIGHTS", (0.1, 1.0))
    monkeypatch.setattr(demo_tours, "PLACES", 8)
    monkeypatch.setattr(demo_tours, "TOURS", 2)
    monkeypatch.setattr(demo_tours, "WORKERS", 1)
    monkeypatch.setattr(demo_tours, "TECHNIQUES", ("hog", "cohog"))
    worlds = [demo_tours.DemoWorld("corridor", "night"), demo_tours.DemoWorld("rail", "rain")]
    monkeypatch.setattr(demo_tours, "WORLDS", worlds)
    monkeypatch.setattr(demo_tours, "OF_DRIVE", 3)
    monkeypatch.delenv("AMUSIC_DATA", raising=False)
    own = simulate(5, queries=30, techniques=3).save(tmp_path / "own")
    out = tmp_path / "out"
    arguments = ["--out", str(out), "--seed", "1", "--bank", str(own)]
    with pytest.raises(ValueError, match="the paper gives no time for"):
        start("demo", arguments)  # before anything is rendered
    assert not out.exists()
    start("demo", [*arguments, "--costs", "runs"])
    said = capsys.readouterr().out
    assert "On tours that no training saw, the selector that ships (ppo), at λ" in said
    assert "On simulated-5, which no training saw, ppo reaches AUC" in said
    assert said.count("WARNING") == 0
    rows = json.loads((out / "results.json").read_text())["rows"]
    assert {r["bank"] for r in rows} == {"tour-1", "tour-2", "simulated-5"}
    assert {"amusic", "music", "cascade", "single:HOG", "random:0.3", demo.SHIPS} <= {
        r["policy"] for r in rows
    }
    stops = json.loads((out / "stops" / "results.json").read_text())["rows"]
    assert {r["bank"] for r in stops} == {"tour-1 with stops"}
    assert {"ppo@belief", "amusic:belief", demo.SHIPS} <= {r["policy"] for r in stops}
    studied = json.loads((out / "study" / "study.json").read_text())
    assert {row["kind"] for row in studied["matches"]} == {
        *("fixed subsets", "A-MuSIC", "cascade", "periodic", "random", "may idle"),
        "value of information",
    }
    assert {row["policy"] for row in studied["matches"]} == {
        *demo.SELECTORS,
    }
    page = (out / "index.html").read_text()
    assert "data:image/png;base64" in page
    assert "data:image/jpeg;base64" in page  # the contact sheet
    assert (out / "study" / "fronts.png").is_file()
    assert (out / "drive.png").is_file()
    assert (out / "drive.mp4").stat().st_size > 1000
    named = {row["rival"] for row in studied["matches"]} - {None}
    assert named & {r["policy"] for r in rows}  # those that the table names have drives
    assert "with stops, by the belief" in page
    assert page.replace("http://www.w3.org/2000/svg", "").count("http") == 1  # the policy's tag
    assert load_selector(out / "run").needs == load_selector().needs
    worlds = [out / "images" / str(seed) / "corridor" / "reference" for seed in (1, 2)]
    one, two = (next(world.glob("*0.jpg")).read_bytes() for world in worlds)
    assert one != two  # each tour has worlds of its own
