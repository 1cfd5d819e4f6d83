"""What the project promises of its policies: one test per row."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from amusic_baselines import make_policy
from amusic_baselines.amusic import differ
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.metrics import summarise
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context

corrections = st.integers(2, 30).flatmap(
    lambda n: arrays(np.float64, (2, n), elements=st.floats(-50, 50, width=32))
)


@given(corrections, st.sampled_from([0.01, 0.05, 0.5]))
def test_39_t_test_is_scipys(pair, alpha) -> None:
    before, after = pair
    assume(np.ptp(after - before) > 1e-6)  # else degenerate: below
    p = stats.ttest_rel(after, before).pvalue
    assume(abs(p - alpha) > 1e-9)
    assert differ(before, after, alpha) == (p < alpha)


@pytest.mark.parametrize("count", [2, 10, 40])
def test_39_all_equal_is_no_rejection(count) -> None:
    values = np.linspace(0.0, 3.0, count)
    assert not differ(values, values)
    assert not differ(np.zeros(count), np.zeros(count))


@pytest.mark.parametrize("count", [2, 10, 40])
@pytest.mark.parametrize("shift", [0.1, -0.1, 1e-6, 7.0, 1 / 3])
def test_39_constant_other_difference_is_a_rejection(count, shift) -> None:
    assert differ(np.zeros(count), np.full(count, shift))
    values = np.arange(count) / 8.0
    assert differ(values, values + shift)


@pytest.mark.parametrize("values", [[], [1.0]])
def test_39_fewer_than_two_values_are_no_rejection(values) -> None:
    assert not differ(values, [value + 5.0 for value in values])


def test_39_degenerate_tests_warn_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for before, after in ([[1, 2], [1, 2]], [[1, 2], [3, 4]], [[1], [2]], [[], []]):
            differ(before, after)


def test_39_corrections_of_several_techniques_are_one_sample() -> None:
    before = np.zeros((2, 5))
    after = np.array([[0.0, 1.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 0.0, 1.0]])
    assert differ(before, after) == differ(before.ravel(), after.ravel())
    assert differ(before, after)


def test_22_a_policy_that_is_never_right_has_auc_0_and_a_warning() -> None:
    scores = np.tile(np.eye(1, 9), (1, 5, 1))  # always place 0
    bank = ScoreBank(scores, ["A"], [1.0], tolerance=0, ground_truth=np.full(5, 8), name="far")
    for name in ("raw:A", "single:A"):
        policy = make_policy(name, Context.of(bank, statistic="evidence"))
        trace = rollout(policy, bank, name=name)
        with pytest.warns(UserWarning, match=f"{name} has no correct match on bank 'far'"):
            row = summarise(trace)
        assert row["auc"] == row["auc_vprbench"] == 0.0


def test_39_differences_within_rounding_are_none() -> None:
    noise = np.array([1e-15, -3e-16, 2e-15, 1e-15, 1e-15])
    assert not differ(np.ones(5), np.ones(5) + noise)
    assert differ(np.ones(5), np.ones(5) + noise + 1e-3)
