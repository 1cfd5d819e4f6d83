"""Promises 21 (the part about queries without a true place) and 22."""

from __future__ import annotations

import numpy as np
import pytest

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation import metrics
from amusic_gym.policies.trace import Trace


def trace_on(ground_truth: list[int], predictions: list[int]) -> Trace:
    frames = len(predictions)
    bank = ScoreBank(
        np.zeros((1, frames, 4)), ["HOG"], [1.0], tolerance=0,
        ground_truth=np.array(ground_truth), name="street",
    )  # fmt: skip
    return Trace.join(
        bank,
        predictions=predictions,
        confidence=np.arange(frames, 0.0, -1.0),
        similarity=np.arange(frames, 0.0, -1.0),
        ran=np.ones((frames, 1), bool),
        policy="single:HOG",
        statistic="mean",
    )


def test_21_a_query_without_a_true_place_counts_wrong_and_is_no_positive() -> None:
    row = metrics.summarise(trace_on([0, -1, 2, -1], [0, 0, 2, 3]))
    assert row["accuracy"] == 0.5
    # Both positives are found, at precision 1 and then 2/3: recall reaches 1, over two positives.
    assert row["auc"] == pytest.approx(0.5 * 1 + 0.5 * (1 / 2 + 2 / 3) / 2)
    assert row["median_error"] == 0.0


def test_21_nor_does_it_ever_match_no_prediction() -> None:
    trace = trace_on([0, -1], [0, -1])
    np.testing.assert_array_equal(trace.correct, [True, False])


def test_21_no_query_with_a_true_place_at_all() -> None:
    with pytest.warns(UserWarning, match="no correct match"):
        row = metrics.summarise(trace_on([-1, -1], [0, 1]))
    assert (row["accuracy"], row["auc"], row["auc_vprbench"], row["auc_paper"]) == (0.0,) * 4
    assert row["median_error"] is None


@pytest.mark.parametrize("measure", [metrics.auc, metrics.auc_vprbench, metrics.auc_paper])
def test_22_no_correct_match_is_auc_0_with_a_warning(measure: object) -> None:
    assert callable(measure)
    with pytest.warns(UserWarning, match="single:HOG has no correct match on bank 'street'"):
        assert measure(trace_on([0, 1, 2], [3, 3, 3])) == 0.0


def test_22_a_summary_warns_once() -> None:
    with pytest.warns(UserWarning, match="its AUC is 0") as caught:
        row = metrics.summarise(trace_on([0, 1, 2], [3, 3, -1]))
    assert len(caught) == 1
    assert (row["auc"], row["auc_vprbench"], row["auc_paper"]) == (0.0,) * 3
