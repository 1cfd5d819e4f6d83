"""The oracle's loops, held against hand-made values, other libraries and real numbers.

An oracle that is itself wrong proves nothing, so nothing of the package is used here.
"""

from __future__ import annotations

import math
from pathlib import Path

import corridor
import golden
import numpy as np
import oracle
import oracle_metrics
import pytest
from scipy import stats
from sklearn import metrics as sklearn_metrics

pytestmark = pytest.mark.slow

STATISTICS = ("mean", "evidence")
FRAMES = range(golden.SCORES.shape[1])


def z_of(technique: int) -> list[list[float]]:
    return [oracle.standardise(row) for row in golden.SCORES[technique]]


# ------------------------------------------------------------------------ the hand-made bank


def test_rows_are_scaled_as_they_were_made() -> None:
    for technique, name in enumerate(golden.TECHNIQUES):
        np.testing.assert_allclose(z_of(technique), golden.Z[name], atol=1e-12)


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize(("name", "q"), golden.WALKS)
def test_sic_gives_the_hand_made_values(name: str, q: int, statistic: str) -> None:
    scores = golden.SCORES[golden.TECHNIQUES.index(name)]
    candidates, sums, terms = golden.WALKS[name, q]
    root = 1.0 if statistic == "mean" else 0.5

    found = oracle.sic(scores, [True] * 5, q, golden.CANDIDATES, statistic=statistic)

    assert found.candidates == candidates
    np.testing.assert_allclose(
        found.statistics,
        [total / n**root for total, n in zip(sums, terms, strict=True)],
        atol=1e-12,
    )
    place, value, correction = golden.SIC[statistic][name][q]
    assert found.place == place
    assert found.statistic == pytest.approx(value, abs=1e-12)
    assert found.correction == pytest.approx(correction, abs=1e-12)


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("settings", golden.OTHER_SETTINGS)
def test_sic_with_other_settings(
    settings: tuple[int, float, tuple[int, ...]], statistic: str
) -> None:
    past, gamma, ran = settings
    found = oracle.sic(golden.SCORES[0], ran, 4, golden.CANDIDATES, past, gamma, statistic)
    assert found[:3] == pytest.approx(golden.OTHER_SETTINGS[settings][statistic], abs=1e-12)


def test_candidates_are_clipped_to_the_map() -> None:
    assert oracle.sic(golden.SCORES[1], [True] * 5, 3, 50).candidates == [0, 1, 2, 3, 4, 5]


def test_a_frame_without_its_row_has_no_sic() -> None:
    with pytest.raises(ValueError, match="did not run on frame 4"):
        oracle.sic(golden.SCORES[0], (1, 1, 1, 1, 0), 4)


@pytest.mark.parametrize(
    ("below", "first"), [(0.0, 0), (1e-10, 0), (1e-8, 1)], ids=["equal", "nearly", "lower"]
)
def test_statistics_within_the_tolerance_are_equal(below: float, first: int) -> None:
    assert oracle.first_best([5.0 - 5.0 * below, 5.0, 4.0]) == first


@pytest.mark.parametrize("statistic", STATISTICS)
def test_music_gives_the_hand_made_values(statistic: str) -> None:
    everything = [[True] * 3] * 5
    for q in FRAMES:
        found = oracle.music(golden.SCORES, everything, q, golden.CANDIDATES, statistic=statistic)
        technique, place, confidence, margin = golden.MUSIC[statistic][q]
        assert (found.technique, found.place) == (technique, place)
        assert found.confidence == pytest.approx(confidence, abs=1e-12)
        assert oracle.margin(found, golden.TOLERANCE) == pytest.approx(margin, abs=1e-12)
        assert oracle.margin(found, tolerance=5) is None


def test_music_hears_only_those_that_ran() -> None:
    ran = [[True, True, False]] * 5
    found = oracle.music(golden.SCORES, ran, 1, golden.CANDIDATES)
    assert found.sics[2] is None
    assert (found.technique, found.place, found.confidence) == (0, 4, 1.0)


@pytest.mark.parametrize(
    ("share", "alpha", "expected"),
    [(0.5, 0.05, golden.AMUSIC_QUIET), (1.0, 0.5, golden.AMUSIC_RESELECTING)],
    ids=["quiet", "re-selecting"],
)
def test_amusic_gives_the_hand_made_run(share: float, alpha: float, expected: dict) -> None:
    block = golden.AMUSIC_BLOCK
    route = oracle.amusic(golden.SCORES, golden.CANDIDATES, block=block, share=share, alpha=alpha)

    assert route.predictions == expected["predictions"]
    assert route.confidences == pytest.approx(expected["confidences"], abs=1e-12)
    assert route.ran == expected["ran"]
    assert [(s.frame, s.tally, s.chosen, s.late_runs) for s in route.selections] == expected[
        "selections"
    ]
    assert route.reselections() == expected["reselections"]
    assert route.runs() == expected["runs"]
    assert oracle_metrics.ptr(route) == pytest.approx(expected["ptr"])
    assert oracle_metrics.compute(route, golden.SECONDS) == pytest.approx(expected["compute"])
    assert route.p_values == pytest.approx({4: expected.get("p_value", 1.0)})
    if "corrections" in expected:
        np.testing.assert_allclose(
            route.selections[-1].corrections, expected["corrections"], atol=1e-12
        )


def test_nothing_is_selected_after_the_last_frame() -> None:
    assert oracle.amusic(golden.SCORES, block=5).selections == []
    assert oracle.amusic(golden.SCORES, block=6).selections == []


# ---------------------------------------------------------------------- the t-test, coverage


def test_t_test_agrees_with_scipy() -> None:
    generator = np.random.default_rng(1)
    for size in (2, 3, 10, 40):
        before, after = generator.normal(size=(2, size))
        expected = stats.ttest_rel(before, after).pvalue
        assert oracle.paired_t_test(before, after) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("before", "after", "p"),
    [
        ([0.5, 0.25], [0.5, 0.25], 1.0),
        ([0.5, 0.25], [0.75, 0.5], 0.0),
        ([0.5], [0.75], 1.0),
        ([], [], 1.0),
    ],
    ids=["all zero", "constant", "one pair", "none"],
)
def test_t_test_where_there_is_no_spread(before: list[float], after: list[float], p: float) -> None:
    assert oracle.paired_t_test(before, after) == p


@pytest.mark.parametrize(
    ("tally", "block", "share", "chosen"),
    [
        ([0, 2, 7, 1], 10, 0.7, [2]),
        ([0, 3, 6, 1], 10, 0.7, [1, 2]),
        ([5, 0, 5, 0], 10, 0.5, [0]),
        ([1, 4, 1, 4], 10, 0.9, [0, 1, 3]),
        ([3, 9, 9, 9], 30, 0.1, [1]),
        ([27, 3], 30, 0.9, [0]),
        ([1, 2], 3, 0.7, [0, 1]),
    ],
)
def test_coverage(tally: list[int], block: int, share: float, chosen: list[int]) -> None:
    assert oracle.coverage(tally, block, share) == chosen


def test_coverage_takes_the_product_as_a_real_number() -> None:
    assert 0.07 * 100 > 7
    assert oracle.coverage([93, 7], 100, 0.07) == [0]
    assert oracle.coverage([7] * 14 + [2], 100, 0.07) == [0]


# -------------------------------------------------------------------------------- metrics


@pytest.mark.parametrize("statistic", STATISTICS)
def test_metrics_of_the_hand_made_bank(statistic: str) -> None:
    route = oracle.always(golden.SCORES, range(3), golden.CANDIDATES, statistic=statistic)
    assert route.similarities == pytest.approx(golden.SIMILARITIES[statistic])
    found = oracle.measure(route, golden.GROUND_TRUTH, golden.SECONDS)
    measured = {name: found[name] for name in golden.METRICS[statistic]}
    assert measured == pytest.approx(golden.METRICS[statistic])
    assert (found["ptr"], found["compute"]) == (1.0, 1.0)


def test_areas_agree_with_scikit_learn() -> None:
    generator = np.random.default_rng(2)
    for _ in range(20):
        correct = generator.random(30) < 0.6
        confidence = generator.integers(0, 12, 30) / 4  # many equal ones
        precision, recall, _ = sklearn_metrics.precision_recall_curve(correct, confidence)
        expected = sklearn_metrics.auc(recall, precision)
        assert oracle_metrics.auc_vprbench(correct, confidence) == pytest.approx(expected)


def test_where_the_curves_start() -> None:
    # Two matches of equal confidence, one right: precision 1/2, recall 1/2 of two queries.
    assert oracle_metrics.auc([True, False], [2.0, 2.0], 2) == pytest.approx(1 / 2 * 1 / 2)
    # VPR-Bench: recall 1 of the one correct match, from (0, 1).
    assert oracle_metrics.auc_vprbench([True, False], [2.0, 2.0]) == pytest.approx(3 / 4)


def test_metrics_where_nothing_is_right() -> None:
    assert oracle_metrics.auc([False] * 3, [1.0, 2.0, 3.0], 3) == 0.0
    assert oracle_metrics.auc_vprbench([False] * 3, [1.0, 2.0, 3.0]) == 0.0


def test_no_prediction_and_no_true_place_are_wrong() -> None:
    truth = np.array([[True, False, True], [False, False, False], [False, True, False]])
    correct = oracle_metrics.correctness([-1, 2, 1], truth)
    assert correct == [False, False, True]
    assert oracle_metrics.positives(truth) == 2
    assert oracle_metrics.accuracy(correct) == pytest.approx(1 / 3)
    assert oracle_metrics.auc(correct, [1.0, 2.0, 3.0], 2) == pytest.approx(0.5)


# ------------------------------------------------------------------------- a real recording


def route_of(policy: str, statistic: str, recording: corridor.Corridor) -> oracle.Route:
    scores = recording.scores.tolist()
    kind, _, name = policy.partition(":")
    if kind == "raw":
        return oracle.uncorrected(scores, recording.techniques.index(name))
    if kind == "single":
        only = [recording.techniques.index(name)]
        return oracle.always(scores, only, statistic=statistic)
    if kind == "music":
        return oracle.always(scores, range(len(scores)), statistic=statistic)
    return oracle.amusic(scores, statistic=statistic)


@pytest.mark.parametrize(("policy", "statistic"), corridor.EXPECTED)
def test_corridor_gives_the_expected_digits(policy: str, statistic: str) -> None:
    recording = corridor.load()
    route = route_of(policy, statistic, recording)
    found = oracle.measure(route, recording.ground_truth, recording.seconds)
    assert corridor.differences(policy, statistic, found) == []


def test_a_wrong_digit_is_seen() -> None:
    row = dict(corridor.EXPECTED["amusic", "mean"])
    assert corridor.differences("amusic", "mean", row) == []
    assert corridor.differences("amusic", "mean", row | {"auc": 0.9837}) != []
    assert corridor.differences("amusic", "mean", row | {"runs": 202}) != []
    with pytest.raises(KeyError):
        corridor.differences("amusic", "mean", {"accuracy": 0.9910, "auc": 0.9836})


def test_the_oracle_does_not_know_the_package() -> None:
    for module in (oracle, oracle_metrics, golden, corridor):
        assert "amusic_gym" not in Path(module.__file__).read_text(encoding="utf-8")


def test_a_constant_row_has_no_deviation() -> None:
    assert oracle.standardise([0.1] * 7) == [0.0] * 7
    assert math.isclose(oracle.standardise([1.0, 3.0])[1], 1.0)
