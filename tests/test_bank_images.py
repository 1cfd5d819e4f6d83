"""The list of a bank's images: what extraction writes, what traces say of each frame."""

from __future__ import annotations

import csv
import json
import shutil

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.extraction import extract
from amusic_gym.policies.trace import Trace
from amusic_gym.routes.bank_images import BankImages, parse_change
from amusic_gym.routes.retime import retimed_frames, save_retimed
from amusic_gym.routes.tours import make_tour


@pytest.fixture
def tour_bank(tmp_path):
    """A bank of a tour of 50 frames, and the tour."""
    for name in ("reference", "query"):
        (tmp_path / name).mkdir()
        for at in range(50):
            image = np.random.default_rng(at).integers(0, 256, (24, 32, 3), np.uint8)
            cv2.imwrite(str(tmp_path / name / f"{at:02}.png"), image)
    tour = make_tour([(tmp_path / "reference", tmp_path / "query")], ["night", "blur"], seed=2)
    bank = extract(
        *(tour.reference, tour.query, "hog"),
        tolerance=1,
        seconds={"HOG": 0.1},
        cache=tmp_path / "cache",
        out=tmp_path / "bank",
    )
    return bank, tour


def test_a_bank_of_images_knows_them_as_the_drive_saw_them(tour_bank):
    bank, tour = tour_bank
    images = BankImages.load(bank)
    for at in (0, 17, 49):
        assert np.array_equal(images.query[at].read(), tour.query[at])
        assert np.array_equal(images.reference[at].read(), tour.reference[at])
    assert BankImages.load(bank.with_costs("runs")) == images


def test_the_list_moves_with_its_images(tour_bank, tmp_path):
    bank, tour = tour_bank
    moved = tmp_path.parent / f"{tmp_path.name}-moved"
    shutil.move(tmp_path, moved)
    images = BankImages.load(ScoreBank.load(moved / "bank"))
    assert np.array_equal(
        images.reference[3].read(), cv2.imread(str(moved / "reference" / "03.png"))
    )


def test_a_re_timed_bank_has_the_frames_that_it_took(tour_bank, tmp_path):
    bank, _ = tour_bank
    retimed = ScoreBank.load(save_retimed(bank, 5, tmp_path / "retimed", "paced"))
    taken = retimed_frames(bank.queries, np.random.default_rng(5), "paced")
    images, own = BankImages.load(retimed), BankImages.load(bank)
    assert images.query == tuple(own.query[at] for at in taken)
    assert images.reference == own.reference


def test_scores_alone_have_no_images(tmp_path):
    bank = ScoreBank(np.zeros((1, 2, 2)), ["A"], [1.0], tolerance=0)
    assert BankImages.load(bank) is None
    assert BankImages.load(ScoreBank.load(bank.save(tmp_path / "bank"))) is None


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda body: {}, "is no list of images"),
        (lambda body: body | {"query": [[1]]}, "is no list of images"),
        (lambda body: body | {"query": [["a", "b"]]}, "is no list of images"),
        (lambda body: body | {"query": body["query"][1:]}, "lists other images"),
    ],
)
def test_a_damaged_list_is_refused(tour_bank, damage, words):
    bank, _ = tour_bank
    path = bank.path / "images.json"
    path.write_text(json.dumps(damage(json.loads(path.read_text()))))
    with pytest.raises(ValueError, match=words):
        BankImages.load(bank)


def test_a_trace_names_query_matched_and_true_file(tour_bank, tmp_path):
    bank, tour = tour_bank
    predictions = np.arange(50)
    predictions[[0, 7]] = -1, 40
    nothing = np.zeros(50)
    trace = Trace.join(
        bank,
        predictions=predictions,
        confidence=nothing,
        similarity=nothing,
        ran=np.ones((50, 1)),
        policy="single:HOG",
        statistic="evidence",
    )
    path = trace.write_csv(tmp_path / "trace.csv", BankImages.load(bank))
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [rows[7][name] for name in ("true_place", "prediction")] == ["7", "40"]
    assert rows[7]["query_file"] == str(tmp_path / "query" / "07.png")
    assert rows[7]["matched_file"] == str(tmp_path / "reference" / "40.png")
    assert rows[7]["true_file"] == str(tmp_path / "reference" / "07.png")
    assert rows[0]["matched_file"] == ""
    changes = [tour.query.changes[at] for at in range(50)]
    assert [row["query_change"] for row in rows] == [str(change or "") for change in changes]
    assert parse_change(rows[7]["query_change"]) == changes[7]


@given(st.data())
def test_the_centre_is_the_middle_of_the_nearest_run_of_true_places(data):
    references = data.draw(st.integers(1, 12))
    matrix = data.draw(
        st.lists(
            st.lists(st.booleans(), min_size=references, max_size=references),
            min_size=1,
            max_size=5,
        )
    )
    places = data.draw(
        st.lists(st.integers(-1, references - 1), min_size=len(matrix), max_size=len(matrix))
    )
    truth = GroundTruth.from_matrix(np.array(matrix))
    half, found = truth.half_run(), truth.centres(places)
    for row, place, centre in zip(matrix, places, found.tolist(), strict=True):
        true = [at for at, on in enumerate(row) if on]
        if not true:
            assert centre == -1
            continue
        nearest = min(true, key=lambda at: abs(at - place))
        low = high = nearest
        while low - 1 in true:
            low -= 1
        while high + 1 in true:
            high += 1
        expected = (low + high) // 2
        if high - low < 2 * half and low == 0:  # cut off by the map's end
            expected = max(high - half, 0)
        elif high - low < 2 * half and high == references - 1:
            expected = min(low + half, high)
        assert centre == expected


@pytest.mark.parametrize("tolerance", [0, 1, 2, 5])
def test_with_a_tolerance_the_centre_is_the_place_also_at_the_ends(tolerance):
    frames = np.arange(30)
    truth = GroundTruth.from_places(frames, tolerance, 30)
    assert truth.centres(frames[::-1]).tolist() == frames.tolist()
