"""The six data sets: as in the paper, and refused with a way out where they are not on disk so."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from image_cases import encoded, picture

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.routes import datasets
from amusic_gym.routes.datasets import DATASETS, Dataset, load_dataset

DOCS = Path(__file__).resolve().parent.parent / "docs" / "datasets.md"

# A-MuSIC, table I: images; section IV-A: tolerance; reference and query traverse.
PAPER = {
    "nordland_winter": (1000, 1, "summer", "winter"),
    "nordland_fall": (1000, 1, "summer", "fall"),
    "berlin": (250, 1, "halenseestrasse-2 kudamm-1 A100-1", "halenseestrasse-1 kudamm-2 A100-2"),
    "night_right": (200, 1, "day_left", "night_right"),
    "st_lucia": (1100, 1, "afternoon", "morning"),
    "17_places": (2000, 10, "day", "night"),
}


def fill(folder: Path, count: int) -> None:
    """Stand-ins: files with the names of images; a data set is not decoded when it is loaded."""
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"{number:05}.jpg").write_bytes(b"%d" % number)


def test_the_registry_says_what_the_paper_says():
    assert list(DATASETS) == list(PAPER)
    for name, (images, tolerance, reference, query) in PAPER.items():
        dataset = DATASETS[name]
        assert (dataset.images, dataset.tolerance) == (images, tolerance), name
        assert [Path(folder).name for folder in dataset.reference] == reference.split(), name
        assert [Path(folder).name for folder in dataset.query] == query.split(), name


def test_documentation_and_registry_agree():
    text = DOCS.read_text("utf-8")
    sections = dict(re.findall(r"^## (.*?)$(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))
    for name, dataset in DATASETS.items():
        (section,) = (body for title, body in sections.items() if f"`{name}`" in title)
        for folder in (*dataset.reference, *dataset.query):
            assert all(f"{part}/" in section for part in Path(folder).parts), (name, folder)
        (row,) = (line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
        assert f"| {dataset.images} |" in row
        assert f"| ±{dataset.tolerance} |" in row


def test_a_data_set_is_loaded_with_its_ground_truth(tmp_path):
    fill(tmp_path / "gardens_point" / "day_left", 200)
    fill(tmp_path / "gardens_point" / "night_right", 200)
    route = load_dataset("night_right", tmp_path)
    assert route.name == "night_right"
    assert route.reference.path.name == "day_left"
    assert route.query.path.name == "night_right"
    assert len(route.reference) == len(route.query) == 200
    band = abs(np.subtract.outer(np.arange(200), np.arange(200))) <= 1
    np.testing.assert_array_equal(route.ground_truth.matrix(), band)
    ScoreBank(
        np.zeros((1, 200, 200)),
        ["T"],
        [1.0],
        ground_truth=route.ground_truth,
        tolerance=route.tolerance,
    )


def berlin(root: Path, sizes: dict[str, int]) -> Path:
    for folder, size in sizes.items():
        fill(root / "berlin" / folder, size)
    return root


def test_berlin_joins_three_pairs(tmp_path):
    counts = {"halenseestrasse": 60, "kudamm": 110, "A100": 80}
    sizes = {f"{street}-{run}": count for street, count in counts.items() for run in (1, 2)}
    route = load_dataset("berlin", berlin(tmp_path, sizes))
    assert route.reference.parts == route.query.parts == (60, 110, 80)
    assert route.reference.names[59:61] == ("halenseestrasse-2/00059.jpg", "kudamm-1/00000.jpg")
    assert route.query.names[59:61] == ("halenseestrasse-1/00059.jpg", "kudamm-2/00000.jpg")
    assert np.flatnonzero(route.ground_truth.matrix()[59]).tolist() == [58, 59]
    assert np.flatnonzero(route.ground_truth.matrix()[60]).tolist() == [60, 61]


def test_berlin_with_pairs_of_different_length_is_refused(tmp_path):
    sizes = {
        "halenseestrasse-1": 61,
        "kudamm-2": 109,
        "A100-2": 80,
        "halenseestrasse-2": 60,
        "kudamm-1": 110,
        "A100-1": 80,
    }
    with pytest.raises(ValueError, match=r"61 \+ 109 \+ 80 images, .* 60 \+ 110 \+ 80: frame q"):
        load_dataset("berlin", berlin(tmp_path, sizes))


def test_first_and_step_choose_among_more_images(tmp_path):
    for side in ("day_left", "night_right"):
        fill(tmp_path / "gardens_point" / side, 450)
    with pytest.raises(ValueError, match=r"paper used 200; pass images=450 \(--images 450\)"):
        load_dataset("night_right", tmp_path)
    route = load_dataset("night_right", tmp_path, first=30, step=2)
    assert len(route.reference) == len(route.query) == 200
    assert route.query.names[:2] == ("00030.jpg", "00032.jpg")
    assert len(load_dataset("night_right", tmp_path, images=450).query) == 450
    with pytest.raises(ValueError, match="holds 450 images, but first=60, step=2, count=200"):
        load_dataset("night_right", tmp_path, first=60, step=2)
    with pytest.raises(ValueError, match="you asked for 7"):
        load_dataset("night_right", tmp_path, images=7)


def test_a_missing_folder_is_refused_with_the_layout_and_the_source(tmp_path):
    fill(tmp_path / "gardens_point" / "day_left", 200)
    with pytest.raises(FileNotFoundError) as caught:
        load_dataset("night_right", tmp_path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{tmp_path}/gardens_point/night_right does not exist. ")
    assert (
        "200 images in gardens_point/day_left and as many in gardens_point/night_right" in sentence
    )
    assert "Zenodo, record 4590133" in sentence
    assert "docs/datasets.md" in sentence


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("night-right", {}, "unknown data set 'night-right': did you mean 'night_right'"),
        ("gardens_point", {}, "'gardens_point' is a folder; the data set in it is night_right"),
        ("nordland", {}, "the data set in it is nordland_winter or nordland_fall"),
        ("berlin", {"first": 0}, "first is 0, but berlin joins several folders; leave it out"),
        ("st_lucia", {"step": 2}, r"step is 2 without first; give first=0 \(--first 0\)"),
        ("st_lucia", {"step": 0}, "step is 0; give a whole number >= 1"),
        ("st_lucia", {"images": 0}, "images is 0; give a whole number >= 1"),
    ],
)
def test_bad_arguments_are_refused(tmp_path, name, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        load_dataset(name, tmp_path, **options)


def test_another_data_set_is_one_entry(tmp_path, monkeypatch):
    mine = Dataset(("mine/a",), ("mine/b",), images=2, tolerance=0, condition="-", source="me")
    monkeypatch.setitem(datasets.DATASETS, "mine", mine)
    for folder in ("a", "b"):
        (tmp_path / "mine" / folder).mkdir(parents=True)
        for number in range(2):
            data = encoded(".png", image=picture(seed=number))
            (tmp_path / "mine" / folder / f"{number}.png").write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        route = load_dataset("mine", tmp_path)
    np.testing.assert_array_equal(route.query[1], picture(seed=1))
    np.testing.assert_array_equal(route.ground_truth.matrix(), np.eye(2, dtype=bool))
