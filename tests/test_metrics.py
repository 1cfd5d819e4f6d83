"""Every number of a results row against a definition written a second time."""

from __future__ import annotations

import json
from typing import Any

import corridor
import numpy as np
import oracle_metrics
import pytest
import sklearn.metrics
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation import metrics
from amusic_gym.policies.trace import Trace

ROW_KEYS = [
    "bank",
    "policy",
    "compute_weight",
    "statistic",
    "carry",
    "costs",
    "queries",
    "accuracy",
    "auc",
    "auc_vprbench",
    "auc_paper",
    "ptr",
    "compute",
    "seconds_per_frame",
    "reselections",
    "idle",
    "median_error",
    "lost",
    *(f"recall_at_{n}" for n in (1, 5, 10, 20)),
    "recall_at_100_precision",
]


def bank_of(has_place: NDArray[np.bool_], seconds: tuple[float, ...] = (1.0, 3.0)) -> ScoreBank:
    """Place 0 is the true one of every query that has one; places 0 and 1 are on the map."""
    frames = len(has_place)
    scores = np.zeros((len(seconds), frames, 2))
    names = [f"T{i}" for i in range(len(seconds))]
    centres = np.where(has_place, 0, -1)
    return ScoreBank(scores, names, seconds, tolerance=0, ground_truth=centres, name="bank")


def trace_of(correct: Any, confidence: Any, has_place: Any = None, **more: Any) -> Trace:
    right = np.asarray(correct, dtype=bool)
    known = np.ones(right.size, bool) if has_place is None else np.asarray(has_place, dtype=bool)
    given_fields = {"ran": np.ones((right.size, 2), bool), "policy": "music", "statistic": "mean"}
    given_fields["similarity"] = np.zeros(right.size)
    return Trace.join(
        bank_of(known), predictions=~right, confidence=confidence, **(given_fields | more)
    )


# (correct, has a place, confidence); few distinct confidences, so that ties are common
FRAMES = st.lists(
    st.tuples(st.booleans(), st.booleans(), st.integers(-3, 3)), min_size=1, max_size=30
)


@given(FRAMES.filter(lambda frames: any(c and h for c, h, _ in frames)))
def test_auc_is_the_explicit_loop(frames: list[tuple[bool, bool, int]]) -> None:
    correct = [c and h for c, h, _ in frames]
    known = [h for _, h, _ in frames]
    confidence = [v / 7 for _, _, v in frames]
    expected = oracle_metrics.auc(correct, confidence, sum(known))
    assert metrics.auc(trace_of(correct, confidence, known)) == pytest.approx(expected, abs=1e-12)


@given(FRAMES.filter(lambda frames: any(c for c, _, _ in frames)))
def test_auc_vprbench_is_scikit_learn(frames: list[tuple[bool, bool, int]]) -> None:
    correct, confidence = [c for c, _, _ in frames], [v / 7 for _, _, v in frames]
    precision, recall, _ = sklearn.metrics.precision_recall_curve(correct, confidence)
    expected = sklearn.metrics.auc(recall, precision)
    trace = trace_of(correct, confidence)
    assert metrics.auc_vprbench(trace) == pytest.approx(expected, abs=1e-12)
    trace = trace_of(correct, np.zeros(len(correct)), similarity=confidence)
    assert metrics.auc_paper(trace) == pytest.approx(expected, abs=1e-12)


@given(FRAMES.filter(lambda frames: len({c for c, _, _ in frames}) == 2))
def test_auroc_is_scikit_learn(frames: list[tuple[bool, bool, int]]) -> None:
    correct, score = [c for c, _, _ in frames], [v / 7 for _, _, v in frames]
    expected = sklearn.metrics.roc_auc_score(correct, score)
    assert metrics.auroc(correct, score) == pytest.approx(expected, abs=1e-12)


def test_precision_recall_by_hand() -> None:
    # Thresholds 3 (right), 2 (right and wrong, tied), 1 (wrong); five queries have a place.
    precision, recall = metrics.precision_recall([1, 0, 1, 0], [3.0, 2.0, 2.0, 1.0], 5)
    np.testing.assert_allclose(precision, [1, 1, 2 / 3, 2 / 4])
    np.testing.assert_allclose(recall, [0, 1 / 5, 2 / 5, 2 / 5])
    assert metrics.area(precision, recall) == pytest.approx(0.2 + 0.2 * (1 + 2 / 3) / 2)


def test_the_two_areas_differ_in_recall_and_in_where_they_start() -> None:
    trace = trace_of([0, 1, 1, 0], [4.0, 3.0, 2.0, 1.0])
    # Precision 0, 1/2, 2/3, 1/2 at 0, 1, 2, 2 true positives.
    after_the_first = (0 + 1 / 2) / 2 + (1 / 2 + 2 / 3) / 2
    assert metrics.auc(trace) == pytest.approx(after_the_first / 4)
    assert metrics.auc_vprbench(trace) == pytest.approx(after_the_first / 2)
    assert metrics.auc_vprbench(trace_of([1, 0], [1.0, 1.0])) == pytest.approx(0.75)
    assert metrics.auc(trace_of([1, 0], [1.0, 1.0])) == pytest.approx(0.25)


def test_summary_by_hand() -> None:
    correct = [1, 0, 0, 0, 0, 0, 1, 0, 0, 1]
    ran = np.array([[1, 1]] * 2 + [[1, 0]] * 7 + [[0, 0]], dtype=bool)
    late_runs = np.zeros((10, 2), int)
    late_runs[4, 1] = 2
    trace = trace_of(
        correct,
        np.arange(10.0),
        similarity=-np.arange(10.0),
        ran=ran,
        late_runs=late_runs,
        selections=np.arange(10) % 4 == 2,
        compute_weight=0.3,
    )
    row = metrics.summarise(trace)
    assert list(row) == ROW_KEYS
    assert (row["bank"], row["policy"], row["statistic"]) == ("bank", "music", "mean")
    assert (row["costs"], row["compute_weight"], row["queries"]) == ("measured", 0.3, 10)
    assert row["accuracy"] == pytest.approx(0.3)
    assert row["ptr"] == pytest.approx((9 + 2 + 2) / 20)
    assert row["compute"] == pytest.approx((9 * 1 + 4 * 3) / (10 * 4))
    assert row["seconds_per_frame"] == pytest.approx(2.1)
    assert row["reselections"] == 1  # selections at 2 and 6
    assert row["idle"] == pytest.approx(0.1)
    assert row["median_error"] == 1.0
    assert row["lost"] == pytest.approx(0.5)
    assert row["auc"] == metrics.auc(trace)
    assert row["auc_vprbench"] == metrics.auc_vprbench(trace)
    assert row["auc_paper"] == metrics.auc_paper(trace)
    assert row["auc_paper"] == pytest.approx(  # from the front: right, five wrong, right, ...
        1 / 3 + (2 / 7 + 1 / 6) / 6 + (3 / 10 + 2 / 9) / 6
    )
    assert json.loads(json.dumps(row, allow_nan=False)) == row


def test_no_selection_is_no_reselection() -> None:
    assert metrics.reselections(trace_of([1], [1.0])) == 0


@pytest.mark.parametrize(
    ("correct", "share"),
    [
        ([0, 0, 0, 0, 1, 0, 0, 0, 0], 0.0),
        ([0, 0, 0, 0, 0, 1, 1, 1, 1, 1], 0.5),
        ([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], 0.5),
        ([0] * 7, 1.0),
        ([1], 0.0),
    ],
)
def test_lost_counts_frames_in_runs_of_five_wrong_ones(correct: list[int], share: float) -> None:
    assert metrics.lost(correct) == pytest.approx(share)


def test_mean_rows_average_banks_and_keep_policies_apart() -> None:
    first = metrics.summarise(trace_of([1, 0], [2.0, 1.0]))
    second = {**first, "bank": "other", "auc": 1.0, "queries": 8, "median_error": None}
    weighted = {**first, "compute_weight": 1.0}
    variant = {**first, "statistic": "evidence", "carry": True}
    plain = {**variant, "carry": False}
    rows = metrics.mean_rows([first, weighted, second, variant, plain])
    assert [(r["compute_weight"], r["statistic"], r["carry"]) for r in rows] == [
        (None, "mean", False),
        (1.0, "mean", False),
        (None, "evidence", True),
        (None, "evidence", False),
    ]
    assert all(list(row) == ROW_KEYS and row["bank"] == "mean" for row in rows)
    assert rows[0]["auc"] == pytest.approx((first["auc"] + 1.0) / 2)
    assert rows[0]["queries"] == 10
    assert rows[0]["median_error"] == first["median_error"]
    assert metrics.mean_rows([second])[0]["median_error"] is None
    assert metrics.mean_rows([]) == []


def test_calibration_numbers_by_hand() -> None:
    correct, estimate = [1, 0, 1, 1], [0.9, 0.1, 0.6, 1.0]
    assert metrics.brier(correct, estimate) == pytest.approx((0.01 + 0.01 + 0.16 + 0) / 4)
    table = metrics.reliability(correct, estimate, bins=2)
    np.testing.assert_array_equal(table.counts, [1, 3])
    np.testing.assert_allclose(table.predicted, [0.1, 2.5 / 3])
    np.testing.assert_allclose(table.observed, [0.0, 1.0])
    expected = 0.25 * 0.1 + 0.75 * (1 - 2.5 / 3)
    assert metrics.calibration_error(correct, estimate, bins=2) == pytest.approx(expected)


def test_empty_bins_are_nan_and_weigh_nothing() -> None:
    table = metrics.reliability([1, 0], [0.95, 0.05], bins=4)
    np.testing.assert_array_equal(np.isnan(table.observed), [False, True, True, False])
    assert metrics.calibration_error([1, 0], [0.95, 0.05], bins=4) == pytest.approx(0.05)


def test_auroc_of_one_class_is_undefined() -> None:
    assert np.isnan(metrics.auroc([1, 1], [0.1, 0.2]))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: metrics.precision_recall([1, 1], [1.0, 2.0], 1), "2 frames are correct but only"),
        (lambda: metrics.precision_recall([1], [1.0, 2.0], 1), "one of each per frame"),
        (lambda: metrics.precision_recall([], [], 0), "one of each per frame"),
        (lambda: metrics.auroc([1, 0], [np.inf, 0.0]), "score of frame 0 is inf"),
        (lambda: metrics.reliability([1], [1.2], 3), r"give values in \[0, 1\]"),
        (lambda: metrics.reliability([1], [1.0], 0), "bins is 0"),
    ],
)
def test_bad_numbers_are_refused(call: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize("technique", corridor.TECHNIQUES)
def test_raw_techniques_on_corridor(technique: str) -> None:
    real = corridor.load()
    bank = ScoreBank(
        real.scores, real.techniques, real.seconds, ground_truth=real.ground_truth, name="Corridor"
    )
    rows = bank.subset([technique]).scores[0]  # (Q, R)
    trace = Trace.join(
        bank,
        predictions=rows.argmax(axis=1),
        confidence=rows.max(axis=1),
        similarity=(rows.max(axis=1) - rows.mean(axis=1)) / rows.std(axis=1),
        ran=np.tile(np.array(bank.techniques) == technique, (bank.queries, 1)),
        policy=f"raw:{technique}",
        statistic="none",
    )
    row = metrics.summarise(trace)
    expected = corridor.EXPECTED[f"raw:{technique}", "mean"]
    for name in ("accuracy", "auc", "auc_vprbench", "auc_paper", "ptr"):
        assert round(row[name], 4) == expected[name], name
