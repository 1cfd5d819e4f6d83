"""Descriptors that techniques give here, as hloc reads them, and back again."""

from __future__ import annotations

import re
from pathlib import Path

import descriptor_cases as cases
import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ranking import highest
from amusic_gym.cli import start
from amusic_gym.routes.images import read_image
from amusic_gym.techniques import make_technique


def describe(out: Path, *words: object) -> None:
    start("bank", ["describe", *map(str, words), "--cache", str(out / "cache"), "--out", str(out)])


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    return tuple(cases.write_images(tmp_path / "images" / name) for name in ("db", "run"))


def hloc_reads(path: Path) -> dict[str, np.ndarray]:
    """As hloc's list_h5_names and get_descriptors find them."""
    found = {}

    def visit(_: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            name = item.parent.name.strip("/")
            with h5py.File(path, "r", libver="latest") as again:
                found[name] = again[name]["global_descriptor"].__array__()

    with h5py.File(path, "r", libver="latest") as file:
        file.visititems(visit)
    return found


def test_hloc_finds_each_image_with_its_descriptor_and_its_pairs(tmp_path, folders, capsys):
    out = tmp_path / "out"
    words = ["--reference", folders[0], "--query", folders[1], "--techniques", "hog"]
    describe(out, *words, "--top-k", 3)
    assert capsys.readouterr().out.split() == [str(out / "HOG.h5"), str(out / "HOG-pairs.txt")]
    found = hloc_reads(out / "HOG.h5")
    assert set(found) == {f"{side}/{name}" for side in ("db", "run") for name in cases.NAMES}
    hog = make_technique("hog")
    for name, vector in found.items():
        expected = hog.describe(read_image(tmp_path / "images" / name))
        np.testing.assert_array_equal(vector, expected)
    with h5py.File(out / "HOG.h5") as file:
        assert file["db/img3.jpg/image_size"][()].tolist() == [16, 12]
    lines = [line.split(" ") for line in (out / "HOG-pairs.txt").read_text().split("\n")]
    expected = []
    for name in cases.NAMES:
        scores = [found[f"run/{name}"] @ found[f"db/{place}"] for place in cases.NAMES]
        best = sorted(range(cases.PLACES), key=lambda at, s=scores: (-s[at], at))[:3]
        expected += [[f"run/{name}", f"db/{cases.NAMES[at]}"] for at in best]
    assert lines == expected


def test_back_again_gives_the_scores_of_the_images(tmp_path, folders):
    out = tmp_path / "out"
    words = ["--reference", folders[0], "--query", folders[1]]
    describe(out, *words, "--techniques", "hog")
    options = ["--tolerance", 1, "--seconds", "HOG=1"]
    more = ["--techniques", "hog", "--cache", out / "cache", "--out", tmp_path / "a"]
    start("bank", ["images", *map(str, [*words, *options, *more])])
    both = ["--reference", f"HOG={out / 'HOG.h5'}/db", "--query", f"HOG={out / 'HOG.h5'}/run"]
    start("bank", ["descriptors", *map(str, [*both, *options, "--out", tmp_path / "b"])])
    first, second = (ScoreBank.load(tmp_path / name).scores for name in "ab")
    np.testing.assert_allclose(first, second, atol=1e-5)


def test_pairs_of_one_traverse_are_with_other_images(tmp_path, folders):
    out = tmp_path / "out"
    describe(out, "--reference", folders[0], "--techniques", "hog", "--top-k", 50)
    lines = [line.split(" ") for line in (out / "HOG-pairs.txt").read_text().split("\n")]
    assert len(lines) == cases.PLACES * (cases.PLACES - 1)
    assert all(query != place for query, place in lines)
    assert {query for query, _ in lines} == set(cases.NAMES)


def test_what_has_no_global_descriptor_is_refused(tmp_path, folders):
    out = tmp_path / "out"
    words = ["--reference", folders[0], "--query", folders[1]]
    with pytest.raises(ValueError, match="'CoHOG' matches images otherwise than by a dot product"):
        describe(out, *words, "--techniques", "cohog")
    with pytest.raises(ValueError, match="top is 0; give a whole number"):
        describe(out, *words, "--techniques", "hog", "--top-k", 0)
    assert not list(out.glob("*.h5"))


def test_an_image_that_cannot_be_read_leaves_nothing_half_written(tmp_path, folders):
    out = tmp_path / "out"
    describe(out, "--reference", folders[0], "--techniques", "hog")
    before = (out / "HOG.h5").read_bytes()
    (folders[1] / "img4.jpg").write_bytes(b"no image")
    words = ["--reference", folders[0], "--query", folders[1], "--techniques", "hog"]
    with pytest.raises(ValueError, match=re.escape(str(folders[1] / "img4.jpg"))):
        describe(out, *words)
    assert (out / "HOG.h5").read_bytes() == before
    assert not list(out.glob(".amusic-*"))


@given(
    st.lists(st.sampled_from([-np.inf, -1.0, 0.0, 0.5, 2.0]), min_size=1, max_size=12),
    st.integers(1, 14),
)
def test_the_highest_are_those_of_a_plain_sort(row, count):
    candidates = [at for at in range(len(row)) if row[at] > -np.inf]
    expected = sorted(candidates, key=lambda at: (-row[at], at))[:count]
    assert highest(np.array(row), count).tolist() == expected
