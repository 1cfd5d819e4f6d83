"""The trace: joined with the bank's truth, checked, read-only, written as CSV."""

from __future__ import annotations

import csv
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.policies.trace import CSV_COLUMNS, FILE_COLUMNS, Trace
from amusic_gym.utils.storage import write_whole

# Five frames on a map of six places, true place q ± 0; frame 3 has no true place.
CENTRES = [0, 1, 2, -1, 4]


def small_bank() -> ScoreBank:
    scores = np.random.default_rng(0).normal(size=(2, 5, 6))
    return ScoreBank(
        scores, ["HOG", "CALC"], [1.0, 3.0], tolerance=0, ground_truth=np.array(CENTRES), name="b"
    )


def small_trace(**changes: Any) -> Trace:
    given: dict[str, Any] = {
        "predictions": [-1, 1, 5, 3, 4],
        "confidence": [0.0, 0.1, 0.2, 0.3, 0.4],
        "similarity": [0.0, 2.5, -0.5, 1 / 3, 4.0],
        "p_correct": [0.0, 0.25, 0.5, np.nan, 1.0],
        "chosen": [-1, 0, 0, 0, 1],
        "ran": [[0, 0], [1, 0], [1, 0], [1, 0], [1, 1]],
        "late_runs": [[0, 0], [0, 0], [0, 0], [0, 2], [0, 0]],
        "selections": [0, 0, 0, 1, 0],
        "policy": "amusic",
        "statistic": "mean",
    } | changes
    return Trace.join(small_bank(), **given)


def test_join_takes_truth_and_costs_from_the_bank() -> None:
    trace = small_trace()
    np.testing.assert_array_equal(trace.correct, [False, True, False, False, True])
    np.testing.assert_array_equal(trace.has_place, [True, True, True, False, True])
    np.testing.assert_array_equal(trace.error, [6.0, 0.0, 3.0, np.nan, 0.0])
    np.testing.assert_array_equal(trace.seconds, [1.0, 3.0])
    assert (trace.techniques, trace.bank, trace.costs) == (("HOG", "CALC"), "b", "measured")
    assert trace.compute_weight is None
    np.testing.assert_array_equal(trace.runs.sum(axis=0), [4, 3])


def test_what_a_policy_does_not_give_is_none_throughout() -> None:
    trace = small_trace(p_correct=None, chosen=None, late_runs=None, selections=None)
    assert np.isnan(trace.p_correct).all()
    assert (trace.chosen == -1).all()
    assert not trace.late_runs.any()
    assert not trace.selections.any()


@pytest.mark.parametrize(("statistic", "carried"), [("mean", False), ("evidence", True)])
def test_places_are_carried_as_the_statistic_has_it_unless_told(statistic, carried) -> None:
    assert small_trace(statistic=statistic).carry is carried
    assert small_trace(statistic=statistic, carry=not carried).carry is not carried


def test_arrays_are_copies_that_nobody_can_change() -> None:
    confidence = np.arange(5.0)
    trace = small_trace(confidence=confidence)
    confidence[:] = 9.0
    np.testing.assert_array_equal(trace.confidence, np.arange(5.0))
    with pytest.raises(ValueError, match="read-only"):
        trace.confidence[0] = 1.0


def test_pickle_keeps_everything() -> None:
    trace = small_trace()
    again = pickle.loads(pickle.dumps(trace))
    for name, value in vars(trace).items():
        np.testing.assert_array_equal(getattr(again, name), value, err_msg=name)


def test_late_runs_fall_on_the_latest_frames_not_seen_yet() -> None:
    late = small_trace().late_frames()
    np.testing.assert_array_equal(np.argwhere(late), [[1, 1], [2, 1]])


def test_a_second_selection_does_not_count_frames_of_the_first() -> None:
    # CALC: after the fact on frame 1 (charged at 2), then on frames 2 and 3 (charged at 4).
    late_runs = [[0, 0], [0, 0], [0, 1], [0, 0], [0, 2]]
    late = small_trace(late_runs=late_runs).late_frames()
    np.testing.assert_array_equal(late[:, 1], [False, True, True, True, False])
    assert not late[:, 0].any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"confidence": [0.0] * 4}, r"confidence has shape \(4,\); give \(5,\)"),
        ({"confidence": [0, 1, np.nan, 3, 4]}, "confidence of frame 2 is nan"),
        ({"similarity": [0, 1, 2, np.inf, 4]}, "similarity of frame 3 is inf"),
        ({"similarity": [0.0] * 6}, r"similarity has shape \(6,\); give \(5,\)"),
        ({"p_correct": [0, 0, 0, 0, 1.5]}, "p_correct of frame 4 is 1.5"),
        ({"predictions": [0, 0, 0, 0, 6]}, "predicted place 6"),
        ({"predictions": [0, 0, 0, 0, 0.5]}, "predictions holds values that are no int64"),
        ({"ran": [[2, 0]] * 5}, "ran holds values that are no bool"),
        ({"ran": [[1, 0, 1]] * 5}, r"ran has shape \(5, 3\); give \(5, 2\)"),
        ({"chosen": [0, 0, 0, 0, 2]}, "chosen technique of frame 4 is 2"),
        ({"late_runs": [[0, 0]] * 4 + [[0, -1]]}, "late_runs of frame 4"),
    ],
)
def test_what_contradicts_itself_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        small_trace(**changes)


def test_a_trace_without_frames_is_refused() -> None:
    trace = small_trace()
    with pytest.raises(ValueError, match="0 frames"):
        Trace(**{**vars(trace), "predictions": np.zeros(0, np.int64)})


def test_csv_has_one_exact_line_per_frame(tmp_path: Path) -> None:
    confidence = [0.0, 0.1, 1 / 3, 0.3, 0.4]
    path = small_trace(confidence=confidence).write_csv(tmp_path / "deep" / "trace.csv")
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == CSV_COLUMNS + FILE_COLUMNS
    assert [row["prediction"] for row in rows] == ["-1", "1", "5", "3", "4"]
    assert [float(row["confidence"]) for row in rows] == confidence
    assert [float(row["similarity"]) for row in rows] == [0.0, 2.5, -0.5, 1 / 3, 4.0]
    assert list(rows[0])[2:4] == ["confidence", "similarity"]
    assert [row["p_correct"] for row in rows] == ["0.0", "0.25", "0.5", "", "1.0"]
    assert [row["correct"] for row in rows] == ["0", "1", "0", "0", "1"]
    assert [row["techniques"] for row in rows] == ["", "HOG", "HOG", "HOG", "HOG+CALC"]
    assert [row["late_runs"] for row in rows] == ["0", "0", "0", "2", "0"]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_whole(tmp_path / "trace.csv", b"old")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("amusic_gym.utils.storage.os.replace", fail)
    with pytest.raises(OSError, match="No space"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
