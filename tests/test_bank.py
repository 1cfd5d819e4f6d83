"""Score banks, their ground truth and the importers."""

from __future__ import annotations

import copy
import itertools
import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amusic_gym.banks.bank import GroundTruth, ScoreBank
from amusic_gym.banks.costs import PAPER_SECONDS
from amusic_gym.banks.importers import from_arrays, from_vprbench
from amusic_gym.utils.names import suggest

PAPER = ("HOG", "CALC", "CoHOG", "NetVLAD")


def make_bank(techniques=("A", "B", "C"), queries=5, references=6, **options) -> ScoreBank:
    scores = np.random.default_rng(7).normal(size=(len(techniques), queries, references))
    seconds = np.arange(1.0, len(techniques) + 1.0)
    options = {"tolerance": 1, "ground_truth": np.arange(queries), **options}
    return ScoreBank(scores, techniques, seconds, **options)


def same(first: ScoreBank, second: ScoreBank) -> bool:
    return (
        np.array_equal(first.scores, second.scores)
        and first.techniques == second.techniques
        and np.array_equal(first.seconds, second.seconds)
        and first.tolerance == second.tolerance
        and np.array_equal(first.truth.matrix(), second.truth.matrix())
        and first.costs == second.costs
    )


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return make_bank(name="route", source="a test").save(tmp_path / "bank")


# ---- ground truth ------------------------------------------------------------------------


@st.composite
def truths_and_predictions(draw):
    queries, references = draw(st.integers(1, 6)), draw(st.integers(1, 9))
    cells = draw(st.lists(st.booleans(), min_size=queries * references, max_size=54))
    matrix = np.array(cells[: queries * references]).reshape(queries, references)
    place = st.integers(-1, references - 1)
    return matrix, draw(st.lists(place, min_size=queries, max_size=queries))


@given(truths_and_predictions())
def test_ground_truth_answers_as_the_matrix_does(case):
    matrix, predictions = case
    truth = GroundTruth.from_matrix(matrix)
    references = matrix.shape[1]
    right = [p >= 0 and bool(matrix[q, p]) for q, p in enumerate(predictions)]
    gaps = []
    for q, p in enumerate(predictions):
        places = np.flatnonzero(matrix[q])
        if not len(places):
            gaps.append(np.nan)
        else:
            gaps.append(references if p < 0 else np.abs(places - p).min())
    frames = np.arange(len(matrix))[::-1]

    np.testing.assert_array_equal(truth.matrix(), matrix)
    np.testing.assert_array_equal(truth.has_place, matrix.any(axis=1))
    np.testing.assert_array_equal(truth.correct(predictions), right)
    np.testing.assert_array_equal(truth.correct(predictions[::-1], frames), right[::-1])
    np.testing.assert_array_equal(truth.distance(predictions), gaps)


def test_places_and_tolerance_are_cut_off_at_the_ends_of_the_map():
    truth = GroundTruth.from_places([0, 3, -1, 4], tolerance=1, references=5)
    expected = [[1, 1, 0, 0, 0], [0, 0, 1, 1, 1], [0, 0, 0, 0, 0], [0, 0, 0, 1, 1]]
    np.testing.assert_array_equal(truth.matrix(), np.array(expected, bool))
    np.testing.assert_array_equal(truth.has_place, [True, True, False, True])


def test_predictions_out_of_range_are_refused():
    truth = GroundTruth.from_places([0, 1], 0, 2)
    with pytest.raises(ValueError, match=r"predicted place 2 \(entry 1\).*valid: -1? ?.*to 1"):
        truth.correct([0, 2])
    with pytest.raises(ValueError, match="frame 2 "):
        truth.correct([0], [2])
    with pytest.raises(ValueError, match="1 predictions for 2 frames"):
        truth.correct([0])
    with pytest.raises(ValueError, match="give a list of integers"):
        truth.correct([0.0, 1.0])


# ---- in memory ---------------------------------------------------------------------------


def test_scores_become_float32_and_are_a_copy():
    scores = np.ones((1, 2, 3), np.int64)
    bank = ScoreBank(scores, ["A"], [1.0], tolerance=0, ground_truth=np.arange(scores.shape[1]))
    scores[:] = 5
    assert bank.scores.dtype == np.float32
    assert bank.shape == (1, 2, 3)
    assert (bank.scores == 1).all()
    assert not bank.scores.flags.writeable
    assert bank.row(0, 1).flags.c_contiguous


def test_a_read_only_memory_map_is_not_copied(tmp_path):
    np.save(tmp_path / "s.npy", np.ones((1, 2, 3), np.float32))
    mapped = np.load(tmp_path / "s.npy", mmap_mode="r")
    assert np.shares_memory(
        ScoreBank(
            mapped, ["A"], [1.0], tolerance=0, ground_truth=np.arange(mapped.shape[1])
        ).scores,
        mapped,
    )


def test_41_tolerance_of_a_matrix_is_half_the_median_run():
    places = GroundTruth.from_places([0, 3, 4, 5, 6], tolerance=2, references=9).matrix()
    assert make_bank(references=9, ground_truth=places, tolerance=None).tolerance == 2
    twice = np.concatenate([places, places], axis=1)  # a map of two laps
    assert make_bank(references=18, ground_truth=twice, tolerance=None).tolerance == 2
    places[:, [0, 8]] = True  # far extra places: the last of a frame, and the first of the next
    assert make_bank(references=9, ground_truth=places, tolerance=None).tolerance == 2


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_41_tolerance_is_half_the_median_run_in_explicit_loops(data):
    queries, references = data.draw(st.integers(1, 6)), data.draw(st.integers(1, 12))
    rows = st.lists(st.booleans(), min_size=references, max_size=references)
    matrix = np.array(data.draw(st.lists(rows, min_size=queries, max_size=queries)))
    longest = []
    for row in matrix.tolist():
        runs = [len(list(run)) for true, run in itertools.groupby(row) if true]
        longest += [max(runs)] if runs else []
    half = int(np.median(longest) / 2) if longest else 0
    assert GroundTruth.from_matrix(matrix).half_run() == half


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_42_widened_is_every_place_within_the_tolerance_in_explicit_loops(data):
    parts = data.draw(st.lists(st.integers(1, 6), min_size=1, max_size=3))
    references, tolerance = sum(parts), data.draw(st.integers(0, 8))
    rows = st.lists(st.booleans(), min_size=references, max_size=references)
    matrix = np.array(data.draw(st.lists(rows, min_size=1, max_size=4)))
    part_of = [part for part, length in enumerate(parts) for _ in range(length)]
    expected = [
        [
            any(row[c] and abs(c - r) <= tolerance and part_of[c] == part_of[r] for c in places)
            for r in places
        ]
        for row, places in ((row, range(references)) for row in matrix.tolist())
    ]
    wide = GroundTruth.from_matrix(matrix).widened(tolerance, parts)
    np.testing.assert_array_equal(wide.matrix(), expected)


def test_42_a_tolerance_beside_a_matrix_is_applied_or_refused():
    middles = np.eye(5, 6, dtype=bool)
    assert make_bank(ground_truth=middles, tolerance=1).truth.matrix()[1].tolist()[:4] == [
        1,
        1,
        1,
        0,
    ]
    wide = GroundTruth.from_matrix(middles).widened(1).matrix()
    assert make_bank(ground_truth=wide, tolerance=1).truth.matrix().tolist() == wide.tolist()
    with pytest.raises(ValueError, match="tolerance is 3, but the ground truth lists neighbouring"):
        make_bank(ground_truth=wide, tolerance=3)


@pytest.mark.parametrize("shape", [(1, 5, 6), (1, 6, 5)])
def test_43_another_number_of_queries_than_of_places_needs_ground_truth(shape):
    sentence = (
        rf"{shape[1]} queries on a map of {shape[2]} places.*per query.*matrix.*list of pairs"
    )
    with pytest.raises(ValueError, match=sentence):
        ScoreBank(np.ones(shape), ["A"], [1.0], tolerance=0)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"tolerance": None}, "tolerance is missing; give tolerance=N"),
        ({"tolerance": -1}, "tolerance is -1; give a whole number"),
        ({"tolerance": 1.5}, "tolerance is 1.5; give a whole number"),
        ({"tolerance": True}, "tolerance is True; give a whole number"),
        ({"costs": "mesured"}, "unknown cost model 'mesured': did you mean 'measured'?"),
        ({"techniques": ["A", "B"]}, "2 technique names for 3 score matrices"),
        ({"techniques": ["A", "B", "A"]}, "technique 'A' is named twice"),
        ({"techniques": ["A", "B", " "]}, "technique name ' ' is empty"),
        ({"techniques": ["A", "B", "C+D"]}, r"technique name 'C\+D' holds one of"),
        ({"techniques": "ABC"}, "give a list of names"),
        ({"seconds": [1, 2]}, "give one number for each of the 3 techniques"),
        ({"seconds": [1, 0, 2]}, "seconds of technique 'B' are 0.0; give a finite number"),
        ({"seconds": [1, 2, np.nan]}, "seconds of technique 'C' are nan"),
        ({"seconds": ["x", 1, 2]}, "give one number per technique"),
        ({"scores": np.ones((5, 6))}, r"scores have shape \(5, 6\)"),
        ({"scores": np.full((3, 5, 6), "x")}, "give real numbers"),
        ({"scores": np.ones((3, 5, 6), complex)}, "give real numbers"),
        ({"scores": np.ones((3, 7, 6))}, "7 queries on a map of 6 places.*give ground_truth"),
    ],
)
def test_bad_arguments_are_refused_with_the_mend(options, sentence):
    good = {"scores": np.ones((3, 6, 6)), "techniques": "A B C".split(), "seconds": [1, 2, 3]}
    with pytest.raises(ValueError, match=sentence):
        ScoreBank(**{"tolerance": 0, **good, **options})


def test_subset_chooses_and_orders_by_name():
    bank = make_bank()
    subset = bank.subset(["C", "A"])
    assert subset.techniques == ("C", "A")
    assert subset.shape == (2, 5, 6)
    np.testing.assert_array_equal(subset.seconds, [3, 1])
    np.testing.assert_array_equal(subset.scores, bank.scores[[2, 0]])
    np.testing.assert_array_equal(subset.row(0, 3), bank.scores[2, 3])
    assert np.shares_memory(subset.stored, bank.stored)
    np.testing.assert_array_equal(subset.subset(["A"]).scores[0], bank.scores[0])
    assert np.shares_memory(bank.subset(["B", "C"]).scores, bank.stored)


def test_subset_refuses_unknown_repeated_and_no_names():
    bank = make_bank(PAPER)
    with pytest.raises(ValueError, match="unknown technique 'HGO': did you mean 'HOG'.* NetVLAD"):
        bank.subset(["HGO"])
    with pytest.raises(ValueError, match="named twice"):
        bank.subset(["HOG", "HOG"])
    with pytest.raises(ValueError, match="no technique; give at least one"):
        bank.subset([])


def test_costs_change_the_seconds_and_come_back():
    bank = make_bank(PAPER)
    paper, runs = bank.with_costs("paper"), bank.with_costs("runs")
    np.testing.assert_array_equal(paper.seconds, [0.045, 0.165, 0.707, 0.722])
    assert list(PAPER_SECONDS) == list(PAPER)
    np.testing.assert_array_equal(runs.seconds, np.ones(4))
    assert (paper.costs, runs.costs, bank.costs) == ("paper", "runs", "measured")
    assert same(paper.subset(["CALC"]).with_costs("measured"), bank.subset(["CALC"]))
    assert np.shares_memory(paper.scores, bank.scores)


def test_costs_refuse_what_they_do_not_know():
    with pytest.raises(ValueError, match="paper gives no time for technique 'B'"):
        make_bank(("HOG", "B")).with_costs("paper")
    with pytest.raises(ValueError, match="unknown cost model 'run': did you mean 'runs'"):
        make_bank().with_costs("run")
    with pytest.raises(ValueError, match="holds the seconds of the cost model 'runs'"):
        make_bank(costs="runs").with_costs("measured")


def test_prepared_rows_are_shared_per_candidates():
    bank = make_bank()
    assert bank.prepared(3) is bank.prepared(3)
    assert bank.prepared(3) is bank.with_costs("runs").prepared(3)
    assert bank.prepared(3) is not bank.prepared(2)
    assert bank.subset(["B"]).prepared(3).top.shape == (1, 5, 3)


# ---- disk --------------------------------------------------------------------------------


def test_save_and_load_give_the_same_bank(saved):
    bank, loaded = make_bank(), ScoreBank.load(saved, verify=True)
    assert same(bank, loaded)
    assert (loaded.name, loaded.source, loaded.path) == ("route", "a test", saved)
    assert not loaded.scores.flags.writeable
    assert isinstance(loaded.stored.base, np.memmap)
    assert sorted(os.listdir(saved)) == ["bank.json", "ground_truth.npz", "scores.npy"]
    assert os.listdir(saved.parent) == ["bank"]  # no leftovers


def test_views_are_saved_as_they_are(saved, tmp_path):
    view = ScoreBank.load(saved).subset(["C", "A"]).with_costs("runs")
    assert same(ScoreBank.load(view.save(tmp_path / "view"), verify=True), view)


def test_a_bank_can_be_saved_over_itself(saved):
    bank = ScoreBank.load(saved)
    bank.subset(["B"]).save(saved)
    assert ScoreBank.load(saved, verify=True).techniques == ("B",)
    assert same(bank, make_bank())  # the map of the replaced file still stands


def test_the_same_bank_gives_the_same_bytes(saved, tmp_path):
    other = make_bank(name="route", source="a test").save(tmp_path / "other")
    for name in os.listdir(saved):
        assert (saved / name).read_bytes() == (other / name).read_bytes()


def test_an_unnamed_bank_takes_its_folder_s_name(tmp_path):
    assert ScoreBank.load(make_bank().save(tmp_path / "tunnel")).name == "tunnel"


def test_save_replaces_nothing_but_a_bank(saved):
    (saved / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match=r"holds other files \(notes.txt\)"):
        make_bank().save(saved)
    with pytest.raises(ValueError, match="exists and is not a folder"):
        make_bank().save(saved / "notes.txt")
    assert (saved / "notes.txt").read_text() == "mine"


def test_a_loaded_bank_pickles_by_path(tmp_path):
    large = make_bank(queries=100, references=100, name="large").save(tmp_path / "large")
    bank = ScoreBank.load(large)
    view = bank.subset(["C", "B"]).with_costs("runs")
    for each in (bank, view):
        each.prepared(5)
        payload = pickle.dumps(each)
        assert len(payload) < 1000
        assert same(pickle.loads(payload), each)
        assert np.shares_memory(copy.deepcopy(each).stored, bank.stored)


def test_a_pickle_refuses_a_bank_that_was_replaced(saved):
    payload = pickle.dumps(ScoreBank.load(saved))
    make_bank(tolerance=2).save(saved)
    with pytest.raises(ValueError, match="was replaced by another one since it was pickled"):
        pickle.loads(payload)


def test_a_bank_in_memory_pickles_by_value():
    view = make_bank(PAPER).subset(["NetVLAD", "HOG"]).with_costs("paper")
    again = pickle.loads(pickle.dumps(view))
    assert same(again, view)
    assert same(again.with_costs("measured"), view.with_costs("measured"))


# ---- importers ---------------------------------------------------------------------------


def write_vprbench(folder: Path, name: str, scores: np.ndarray, ids: list[int]) -> None:
    items = np.empty(6, object)
    items[:] = [np.array(ids), scores.argmax(1), scores.max(1), scores, 0.5, 0.01]
    (folder / name).mkdir(parents=True)
    np.save(folder / name / "precomputed_data_corrected.npy", items, allow_pickle=True)


def test_arrays_are_put_together_by_name(tmp_path):
    scores = np.random.default_rng(0).normal(size=(2, 4, 5))
    for name, matrix in zip("AB", scores, strict=True):
        np.save(tmp_path / f"{name}.npy", matrix)
    np.save(tmp_path / "truth.npy", np.array([0, 1, -1, 4]))
    bank = from_arrays(
        {"B": tmp_path / "B.npy", "A": tmp_path / "A.npy"},
        {"A": 1.0, "B": 2.0},
        tolerance=0,
        ground_truth=tmp_path / "truth.npy",
    )
    assert bank.techniques == ("B", "A")
    np.testing.assert_array_equal(bank.seconds, [2.0, 1.0])
    np.testing.assert_array_equal(bank.scores, scores[::-1].astype(np.float32))
    np.testing.assert_array_equal(bank.truth.has_place, [True, True, False, True])
    assert bank.source == "arrays: B.npy, A.npy"


def test_arrays_that_do_not_fit_are_refused(tmp_path):
    np.save(tmp_path / "A.npy", np.ones((4, 5)))
    np.save(tmp_path / "B.npy", np.ones((4, 6)))
    np.save(tmp_path / "flat.npy", np.ones(4))
    a, b = tmp_path / "A.npy", tmp_path / "B.npy"
    with pytest.raises(ValueError, match=r"technique 'B' have shape \(4, 6\), those of 'A' \(4, 5"):
        from_arrays({"A": a, "B": b}, {"A": 1, "B": 1}, tolerance=0)
    with pytest.raises(ValueError, match=r"flat.npy has shape \(4,\)"):
        from_arrays({"A": tmp_path / "flat.npy"}, {"A": 1}, tolerance=0)
    square = tmp_path / "square.npy"
    np.save(square, np.ones((4, 4)))
    with pytest.raises(ValueError, match="no seconds for technique 'A'"):
        from_arrays({"A": square}, {}, tolerance=0)
    with pytest.raises(ValueError, match="seconds: unknown technique 'a': did you mean 'A'"):
        from_arrays({"A": square}, {"A": 1, "a": 1}, tolerance=0)
    with pytest.raises(FileNotFoundError, match="none.npy does not exist"):
        from_arrays({"A": tmp_path / "none.npy"}, {"A": 1}, tolerance=0)
    with pytest.raises(ValueError, match="is a folder; give a file"):
        from_arrays({"A": tmp_path}, {"A": 1}, tolerance=0)


def test_vprbench_rows_are_ordered_by_query_id(tmp_path):
    scores = np.random.default_rng(0).normal(size=(3, 4))
    write_vprbench(tmp_path / "precomputed_matches", "X", scores, [2, 0, 1])
    truth = np.empty((3, 2), object)
    truth[:] = [[1, None], [0, None], [2, None]]
    truth[:, 1] = [[1, 2], [0], []]
    np.save(tmp_path / "gt.npy", truth, allow_pickle=True)
    bank = from_vprbench(tmp_path, ["X"], tmp_path / "gt.npy", trust=True)
    np.testing.assert_array_equal(bank.scores[0], scores[[1, 2, 0]].astype(np.float32))
    np.testing.assert_allclose(bank.seconds, [0.5 + 4 * 0.01])
    expected = [[1, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]]
    np.testing.assert_array_equal(bank.truth.matrix(), np.array(expected, bool))


def test_vprbench_of_another_layout_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        from_vprbench(tmp_path / "nowhere", ["X"], np.arange(3), trust=True)
    with pytest.raises(FileNotFoundError, match="holds no TECHNIQUE/precomputed_data"):
        from_vprbench(tmp_path, ["X"], np.arange(3), trust=True)
    write_vprbench(tmp_path, "X", np.ones((3, 4)), [0, 0, 1])
    with pytest.raises(ValueError, match="query ids"):
        from_vprbench(tmp_path, ["X"], np.arange(3), trust=True, tolerance=0)
    with pytest.raises(ValueError, match="unknown technique 'x': did you mean 'X'"):
        from_vprbench(tmp_path, ["x"], np.arange(3), trust=True, tolerance=0)
    file = tmp_path / "X" / "precomputed_data_corrected.npy"
    np.save(file, np.array([None, {}]), allow_pickle=True)
    with pytest.raises(ValueError, match="is not laid out as VPR-Bench's matches are"):
        from_vprbench(tmp_path, ["X"], np.arange(3), trust=True, tolerance=0)


@pytest.fixture(scope="module")
def data() -> Path:
    if not os.environ.get("AMUSIC_DATA"):
        pytest.skip("AMUSIC_DATA does not name a folder of real recordings")
    return Path(os.environ["AMUSIC_DATA"])


def test_corridor_is_the_same_from_arrays_and_from_vprbench(data):
    times = json.loads((data / "corridor" / "techniques.json").read_text())
    arrays = from_arrays(
        {name: data / "corridor" / "scores" / f"{name}.npy" for name in PAPER},
        {name: times[name]["encode_s"] + 111 * times[name]["match_s"] for name in PAPER},
        ground_truth=data / "corridor" / "ground_truth.npy",
    )
    folder = data / "vprbench_corridor"
    matches = from_vprbench(folder, PAPER, folder / "ground_truth_new.npy", trust=True)
    np.testing.assert_allclose(matches.scores, arrays.scores, rtol=2e-7)
    np.testing.assert_allclose(matches.seconds, arrays.seconds, rtol=1e-12)
    np.testing.assert_array_equal(matches.truth.matrix(), arrays.truth.matrix())
    assert matches.tolerance == arrays.tolerance == 2
    for bank in (arrays, matches):
        accuracy = [bank.truth.correct(rows.argmax(axis=1)).mean() for rows in bank.scores]
        np.testing.assert_allclose(accuracy, [0.4775, 0.3243, 0.6216, 0.6757], atol=5e-5)


# ---- names -------------------------------------------------------------------------------


def test_suggestions_name_the_nearest_and_list_all():
    assert suggest("technique", "HGO", ["HOG", "CALC"]) == (
        "unknown technique 'HGO': did you mean 'HOG'? valid: HOG, CALC"
    )
    assert suggest("technique", "cohog", PAPER).startswith(
        "unknown technique 'cohog': did you mean 'CoHOG'?"
    )
    assert suggest("policy", 3, ["music"]) == "unknown policy 3: valid: music"
