"""Tables mark what a robot could not run without labelled frames, and say what that means."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from amusic_agents.config import TrainingConfig
from amusic_agents.network import SelectorNetwork
from amusic_agents.run_folder import CONFIG, read_config, stored, write_config, write_selector
from amusic_agents.selector import learned_from_truth
from amusic_agents.shipped import SHIPPED, shipped
from env_cases import random_bank
from small_training import SMALL
from study_cases import EVERYBODY, learned, plan_of

from amusic_gym.evaluation import study
from amusic_gym.evaluation.comparison import SHOWN, compare, table
from amusic_gym.evaluation.contestants import contestants
from amusic_gym.evaluation.report import write_report
from amusic_gym.evaluation.study.figures import _styles
from amusic_gym.evaluation.study.lineup import Lineup
from amusic_gym.evaluation.study.tables import tables
from amusic_gym.evaluation.tables import Table, footnote, legend, marked

pytestmark = pytest.mark.slow

NEEDS = {"oracle": "of the route itself", "switchhit": "of routes to learn from"}


def run_folder(folder: Path, reward: str) -> Path:
    """A run folder of an untrained selector that says what its reward was."""
    config = TrainingConfig(**{**SMALL, "reward": reward})
    write_selector(folder, SelectorNetwork(config.network), config.network)
    write_config(folder, stored(config, [], None))
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> dict[str, str]:
    """Specs of a selector that learned from the truth, and of one that did not."""
    folder = tmp_path_factory.mktemp("runs")
    return {
        name: f"ppo:{run_folder(folder / name, reward)}"
        for name, reward in (("told", "ground_truth"), ("alone", "estimated"))
    }


def test_a_mark_and_its_footnote_are_for_those_that_need_ground_truth_and_are_shown():
    assert [marked(name, NEEDS) for name in ("oracle", "music")] == ["oracle †", "music"]
    assert footnote(["music", "oracle", "music", "oracle"], NEEDS) == (
        "† has seen ground truth: oracle of the route itself."
    )
    assert footnote(["switchhit", "oracle"], NEEDS) == (
        "† has seen ground truth: switchhit of routes to learn from; oracle of the route itself."
    )
    assert footnote(["music"], NEEDS) == ""
    assert footnote([], NEEDS) == ""


def test_a_run_folder_says_whether_its_selector_learned_from_the_truth(runs, tmp_path):
    folders = {name: Path(spec.removeprefix("ppo:")) for name, spec in runs.items()}
    assert learned_from_truth(folders["told"])
    assert not learned_from_truth(folders["alone"])
    assert all(learned_from_truth(shipped(statistic)) for statistic in SHIPPED)
    for training in ({}, None):  # still loads, so it is not refused here
        config = {**read_config(folders["told"]), "training": training}
        write_config(tmp_path, config)
        assert not learned_from_truth(tmp_path)
    (tmp_path / CONFIG).unlink()
    with pytest.raises(FileNotFoundError, match="is no run folder"):
        learned_from_truth(tmp_path)


def test_a_comparison_marks_peers_bounds_and_selectors_that_need_ground_truth(runs, tmp_path):
    specs = ["music", "oracle", "switchhit:0.6", runs["told"], runs["alone"]]
    made = contestants(specs, compute_weights=(0.3,))
    result = compare(
        [random_bank(seed, queries=12) for seed in (1, 2)],
        lambda bank: made,
        tmp_path,
        report=len,
    )
    shown = table(result).partition("WARNING")[0]
    *blocks, meanings, note = shown.strip().split("\n\n")
    assert len(blocks) == 3
    assert " ".join(meanings.split()) == legend(SHOWN)
    for block in blocks:
        lines = block.splitlines()[2:]
        assert [line.split()[1] == "†" for line in lines] == [False, True, True, True, False]
    assert note == (
        "† has seen ground truth: oracle of the route itself; switchhit:0.6 of routes to learn "
        f"from; {runs['told']} of the routes that it was trained on."
    )
    assert [row["policy"] for row in result.rows[:5]] == specs  # as other programs read them
    plain = compare(
        [random_bank(1, queries=12)], lambda bank: made[:1], tmp_path / "plain", report=len
    )
    assert "†" not in table(plain)


def test_a_study_takes_the_marks_of_policies_and_of_runs(runs):
    lineup = Lineup(
        policies=("music", "oracle", "switchhit:0.6@mean", runs["told"]),
        selectors={"told": (runs["alone"], runs["told"]), "alone": (runs["alone"],)},
        all_subsets=False,
        insisted={},
        compute_weights=(0.3,),
    )
    needs = {one.name: one.needs_truth for one in lineup.entrants(["A", "B"]) if one.needs_truth}
    assert needs == {
        "oracle": "of the route itself",
        "switchhit:0.6@mean": "of routes to learn from",
        runs["told"]: "of the routes that it was trained on",
        "told": "of the routes that it was trained on",
    }


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> study.Findings:
    """A study in which a selector needs ground truth, besides the oracle."""
    told = replace(learned("told"), needs_truth="of the routes that it was trained on")
    plan = plan_of([*EVERYBODY, told], [random_bank(1, queries=30, references=40)])
    finished = study.run(plan, tmp_path_factory.mktemp("study"), report=len)
    return study.find(plan, finished, rivals=["told"])


def test_every_table_of_a_study_that_has_a_mark_says_what_it_means(found):
    meanings = {
        "oracle": "oracle of the route itself",
        "told": "told of the routes that it was trained on",
    }
    seen = {name: [table.title for table in tables(found) if has(table, name)] for name in meanings}
    assert len(seen["oracle"]) == 4  # points and three fronts
    assert len(seen["told"]) == 9  # margins, audit and the best of each kind, three, as well
    for one in tables(found):
        cells = {cell for row in one.rows for cell in row}
        assert not cells & set(meanings)  # never without the mark
        for name, meaning in meanings.items():
            assert (meaning in one.note) == has(one, name), one.title


def has(one: Table, name: str) -> bool:
    return any(f"{name} †" in row for row in one.rows)


def test_a_study_s_figures_mark_once(found):
    labels = {name: style.label for name, style in _styles(found).items()}
    assert (labels["oracle"], labels["told"]) == ("oracle †", "told †")
    assert sum("†" in label for label in labels.values()) == 2


def test_a_report_says_below_the_table_what_the_mark_means(tmp_path):
    result = compare(
        [random_bank(1, queries=12)],
        lambda bank: contestants(["music", "oracle"]),
        tmp_path,
        report=len,
    )

    def page(rows: list[dict[str, Any]]) -> str:
        return write_report(tmp_path / "x.html", title="t", sentences=[], rows=rows).read_text()

    note = '<p class="note">† has seen ground truth</p></section>'
    assert note in page(result.rows)
    assert "†" not in page(result.rows[:1])
