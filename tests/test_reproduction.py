"""The paper's experiments: its data sets, tables and figures, and what is said of what lacks."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from env_cases import random_bank
from extraction_cases import make_images

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.cli import start
from amusic_gym.evaluation.reproduction import sweeps, tables
from amusic_gym.evaluation.reproduction.paper import METHODS, TITLES, figures
from amusic_gym.evaluation.reproduction.routes import ONE_DRIVE, joined, load
from amusic_gym.routes.datasets import DATASETS, LoadedRoute
from amusic_gym.routes.folders import ImageFolder


def test_the_papers_figures_are_whole_and_those_of_its_text():
    paper = figures()
    assert list(paper["auc"]) == sorted(TITLES, key=list(paper["auc"]).index)
    assert set(TITLES) == set(DATASETS) == set(paper["adaptation"])
    assert all(
        list(paper[key][name]) == list(METHODS)
        for key in ("auc", "milliseconds")
        for name in TITLES
    )
    averages = [round(float(np.mean([paper["auc"][n][m] for n in TITLES])), 2) for m in METHODS]
    assert averages == [0.35, 0.37, 0.42, 0.52, 0.58, 0.79, 0.82, 0.89, 0.94, 0.93]
    assert sum(row["technique_runs"] for row in paper["adaptation"].values()) == 9000


def cell(auc: float, milliseconds: float = 1.0) -> dict[str, float]:
    return {
        "auc": auc,
        "accuracy": auc,
        "milliseconds": milliseconds,
        "milliseconds_paper": 2 * milliseconds,
    }


def test_tables_stand_beside_the_papers_and_leave_a_gap_for_what_lacks():
    cells = {"night_right": {method: cell(0.5, 10.0) for method in METHODS}}
    two = tables.table_two(cells)
    assert two.heads == ["method", *TITLES.values(), "mean"]
    winter, night = (two.heads.index(TITLES[n]) for n in ("nordland_winter", "night_right"))
    assert two.rows[0][winter] == "– / 0.29"
    assert two.rows[0][night] == two.rows[0][-1] == "0.50 / 0.03"
    assert tables.table_times(cells).rows[-1] == ["A-MuSIC", "10.0", "20.0", "766.0"]
    three = tables.table_three(
        {"night_right": {"ptr": 0.4, "technique_runs": 321, "re_selections": 3}}
    )
    assert three.rows[list(TITLES).index("night_right")] == [
        "Night-Right",
        "0.40 / 0.40",
        "321 / 320",
        "3 / 15",
    ]
    lines = list(csv.reader(tables.to_csv(two).decode().splitlines()))
    assert lines[0][:3] == ["method", "Winter", "Winter (paper)"]
    assert lines[1][:3] == ["HOG", "", "0.29"]
    latex = tables.to_latex(two).decode()
    assert r"HOG & -- (0.29) &" in latex
    assert latex.count(r"\\") == 1 + len(METHODS)


def test_tables_have_the_drive_of_all_and_no_figure_of_the_papers_beside_it():
    cells = {
        name: {method: cell(auc) for method in METHODS}
        for name, auc in (("night_right", 0.5), ("berlin", 0.7), (ONE_DRIVE, 0.25))
    }
    two = tables.table_two(cells)
    assert two.heads[-2:] == ["mean", "in one drive"]
    assert two.rows[0][-2:] == ["0.60 / 0.03", "0.25"]
    assert tables.table_times(cells).rows[0][1] == "1.0"
    three = tables.table_three({ONE_DRIVE: {"ptr": 0.4, "technique_runs": 321, "re_selections": 3}})
    assert three.rows[-1] == ["in one drive", "0.40 / –", "321 / –", "3 / –"]
    assert tables.to_csv(two).decode().splitlines()[0].endswith("mean,mean (paper),in one drive")


def dataset(root: Path, name: str, reference: str, count: int, tolerance: int) -> LoadedRoute:
    folders = [ImageFolder(root / each) for each in (reference, name)]
    truth = GroundTruth.from_places(np.arange(count), tolerance, count)
    return LoadedRoute(*folders, truth, tolerance, name)


def test_joined_data_sets_are_one_drive_on_one_map_each_frame_true_in_its_part(tmp_path):
    for number, (name, count) in enumerate({"summer": 4, "winter": 4, "fall": 4, "day": 3}.items()):
        make_images(tmp_path / name, count, seed=number)
    make_images(tmp_path / "night", 3, seed=9)
    parts = [
        dataset(tmp_path, "winter", "summer", 4, 1),
        dataset(tmp_path, "night", "day", 3, 0),
        dataset(tmp_path, "fall", "summer", 4, 1),
    ]
    one = joined(parts)
    assert (len(one.reference), len(one.query), one.name) == (11, 11, ONE_DRIVE)
    true = [np.flatnonzero(row).tolist() for row in one.ground_truth.matrix()]
    twice = [[0, 1, 7, 8], [0, 1, 2, 7, 8, 9], [1, 2, 3, 8, 9, 10], [2, 3, 9, 10]]
    assert true == [*twice, [4], [5], [6], *twice]
    assert np.array_equal(one.query[4], parts[1].query[0])
    assert np.array_equal(one.reference[7], parts[0].reference[0])


def test_with_one_candidate_a_technique_is_what_it_is_alone():
    bank = random_bank(seed=3, techniques=2, queries=40, references=40)
    rows = {(row["candidates"], row["history"]): row for row in sweeps.ablate([bank])}
    assert set(rows) == {(k, f) for k in sweeps.CANDIDATES for f in sweeps.HISTORIES}
    alone = np.mean([bank.truth.correct(s.argmax(axis=1)).mean() for s in np.asarray(bank.scores)])
    for history in sweeps.HISTORIES:
        assert rows[1, history]["accuracy"] == pytest.approx(alone)
    assert all(row["milliseconds"] > 0 for row in rows.values())


def winter(root: Path, count: int) -> None:
    for name in ("summer", "winter"):
        make_images(root / "nordland" / name, count, seed=2, size=(120, 160))


def night_right(root: Path, count: int) -> None:
    make_images(root / "gardens_point" / "day_left", count, seed=1, size=(120, 160))
    make_images(root / "gardens_point" / "night_right", count, seed=1, size=(120, 160))


@pytest.mark.parametrize(
    ("count", "used", "remark"),
    [
        (200, 200, None),
        (410, 200, "200 of 410 images, one in 2"),
        (30, 30, "30 images, the paper took 200"),
    ],
)
def test_other_numbers_of_images_than_the_papers_are_told(tmp_path, count, used, remark):
    for name in ("day_left", "night_right"):
        make_images(tmp_path / "gardens_point" / name, count, seed=len(name))
    found, remarks = load("night_right", tmp_path)
    assert len(found.reference) == len(found.query) == used
    assert any("8×6 pixels" in told for told in remarks)
    assert len(remarks) == 1 + (remark is not None)
    assert remark is None or remarks[0].startswith(remark)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*(same image|correct match)")  # pictures of noise
def test_the_command_writes_tables_figures_and_a_page_and_says_what_lacks(tmp_path, capsys):
    night_right(tmp_path / "data", 25)
    winter(tmp_path / "data", 22)
    words = [
        "--root",
        str(tmp_path / "data"),
        "--out",
        str(tmp_path / "out"),
        "--cache",
        str(tmp_path / "cache"),
    ]
    start("reproduce", words, "amusic reproduce")
    said = capsys.readouterr().out
    out = tmp_path / "out"
    assert "berlin needs below" in said
    assert "25 images, the paper took 200; weights of calc that ship" in said
    numbers = json.loads((out / "reproduction.json").read_text())
    assert list(numbers["table2"]) == ["nordland_winter", "night_right", ONE_DRIVE]
    assert list(numbers["table3"]) == list(numbers["table2"])
    assert set(numbers["table2"]["night_right"]) == set(METHODS)
    assert len(numbers["sweep"]) == len(sweeps.ADAPTIVE)
    named = ["figure3", "figure4", "figure5-night_right", "figure6", "figure7-night_right", "sweep"]
    named += [f"figure7-{ONE_DRIVE}"]
    for name in named:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    for name in ("table2.csv", "table2.tex", "table3.csv", "table3.tex", "tables.md", "index.html"):
        assert (out / name).stat().st_size > 0
    start("reproduce", words, "amusic reproduce")
    rows = 3 * len(METHODS) + 2 * len(sweeps.ADAPTIVE)
    assert capsys.readouterr().out.count("(was finished)") == rows


def test_none_of_the_data_sets_is_refused(tmp_path):
    with pytest.raises(
        FileNotFoundError, match="none of the data sets is there: .*nordland_winter"
    ):
        start("reproduce", ["--root", str(tmp_path), "--out", str(tmp_path / "out")], "amusic")
