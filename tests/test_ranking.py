"""Ranked lists, Recall@N and recall at 100 % precision against plain loops and scikit-learn."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np
import pytest
import sklearn.metrics
from amusic_baselines import make_policy
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ranking import ranked, true_ranks
from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.comparison import LIST_COLUMNS, compare, ranked_lists
from amusic_gym.evaluation.contestants import contestants
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context
from amusic_gym.policies.trace import Trace

TECHNIQUES, QUERIES, PLACES = 3, 5, 6
SCORES = st.sampled_from([-np.inf, -1.5, 0.0, 0.25, 1.0, 3.0])  # few, so that ties are common


def plain_list(bank: ScoreBank, frame: int, ran: Any, prediction: int) -> list[int]:
    """The prediction, then all other candidates by their mean z-score, ties to the lower place."""
    rows = [bank.row(t, frame).astype(float) for t in range(len(ran)) if ran[t]]
    means = {}
    for place in range(bank.references):
        if not rows or any(row[place] == -np.inf for row in rows):
            continue
        z = []
        for row in rows:
            held = row[row > -np.inf]
            even = held.max() == held.min()
            z.append(0.0 if even else (row[place] - held.mean()) / held.std())
        means[place] = round(sum(z) / len(z), 9)
    order = sorted((place for place in means if place != prediction), key=lambda p: (-means[p], p))
    return [prediction, *order] if prediction >= 0 else order


@st.composite
def frames(draw: st.DrawFn) -> tuple[ScoreBank, Any, Any]:
    scores = draw(arrays.arrays(np.float32, (TECHNIQUES, QUERIES, PLACES), elements=SCORES))
    truth = draw(arrays.arrays(np.bool_, (QUERIES, PLACES)))
    bank = ScoreBank(scores, list("ABC"), [1, 2, 3], ground_truth=truth)
    ran = draw(arrays.arrays(np.bool_, (QUERIES, TECHNIQUES)))
    predictions = draw(arrays.arrays(np.int64, QUERIES, elements=st.integers(-1, PLACES - 1)))
    return bank, ran, predictions


@settings(deadline=None)
@given(frames())
def test_lists_and_ranks_are_the_plain_loops(case: tuple[ScoreBank, Any, Any]) -> None:
    bank, ran, predictions = case
    ranks = true_ranks(bank, predictions, ran)
    for frame in range(QUERIES):
        prediction = int(predictions[frame])
        found = ranked(bank, frame, ran[frame], prediction, PLACES).tolist()
        expected = plain_list(bank, frame, ran[frame], prediction)
        assert sorted(found) == sorted(expected)
        if ran[frame].sum() < 2:  # sums of several rows tie but for their last bits
            assert found == expected
        true = [at for at, place in enumerate(found, 1) if bank.truth.is_true(place, frame)]
        assert ranks[frame] == (true[0] if true else 0)
        assert ranked(bank, frame, ran[frame], prediction, 2).tolist() == found[:2]


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_fused_lists_are_the_plain_loops_where_nothing_ties(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scale, offset = (np.reshape(each, (3, 1, 1)) for each in ((1, 50, 0.01), (9, 0, -3)))
    scores = scale * rng.normal(size=(TECHNIQUES, 1, 40)) + offset
    bank = ScoreBank(scores, list("ABC"), [1, 2, 3], tolerance=0, ground_truth=np.array([7]))
    for ran in ([1, 1, 1], [0, 1, 1], [1, 0, 1]):
        chosen = np.array(ran, bool)
        found = ranked(bank, 0, chosen, 3, 40).tolist()
        assert found == plain_list(bank, 0, chosen, 3)
        assert true_ranks(bank, np.array([3]), chosen[None]).tolist() == [found.index(7) + 1]


def routes(seed: int) -> ScoreBank:
    """Different scores, so that nothing ties; some queries have no true place."""
    rng = np.random.default_rng(seed)
    centres = rng.integers(-1, 30, 50)
    scores = rng.normal(size=(2, 50, 30))
    scores[:, np.arange(50), centres] += 1.5
    return ScoreBank(scores, ["A", "B"], [1, 2], tolerance=0, ground_truth=centres, name="bank")


def trace_of(bank: ScoreBank, spec: str) -> Trace:
    return rollout(make_policy(spec, Context.of(bank, statistic="mean")), bank, name=spec)


@pytest.mark.parametrize("seed", range(3))
def test_recall_of_one_technique_is_scikit_learns_top_k_accuracy(seed: int) -> None:
    bank = routes(seed)
    trace = trace_of(bank, "raw:B")
    known = np.flatnonzero(trace.has_place)
    labels = [int(bank.truth.places[bank.truth.indptr[frame]]) for frame in known]
    for n in (1, 5, 10, 20):
        expected = sklearn.metrics.top_k_accuracy_score(
            labels, bank.scores[1][known], k=n, labels=np.arange(30)
        )
        assert metrics.recall_at(trace, n) == pytest.approx(expected, abs=1e-12)
        assert metrics.summarise(trace)[f"recall_at_{n}"] == metrics.recall_at(trace, n)


@pytest.mark.parametrize("spec", ["raw:A", "single:A", "music", "borda", "random:0.3/idle"])
def test_recall_at_full_precision_is_scikit_learns(spec: str) -> None:
    trace = trace_of(routes(5), spec)
    precision, recall, _ = sklearn.metrics.precision_recall_curve(trace.correct, trace.confidence)
    share = trace.correct.sum() / trace.has_place.sum()
    expected = share * recall[:-1][precision[:-1] == 1].max(initial=0)
    assert metrics.recall_at_full_precision(trace) == pytest.approx(expected, abs=1e-12)


def test_recall_at_full_precision_by_hand() -> None:
    bank = ScoreBank(np.eye(20)[None], ["A"], [1], tolerance=0)
    given_ = {"ran": np.ones((20, 1), bool), "policy": "x", "statistic": "none"}
    for wrong, expected in (([19], 0.95), ([15], 0.75), ([0], 0.0), ([], 1.0)):
        places = np.arange(20)
        places[wrong] = (places[wrong] + 1) % 20
        sure = -np.arange(20.0)
        trace = Trace.join(bank, predictions=places, confidence=sure, similarity=sure, **given_)
        assert metrics.recall_at_full_precision(trace) == pytest.approx(expected)
        assert metrics.recall_at(trace, 1) == trace.correct.mean()
        assert metrics.recall_at(trace, 5) == 1.0


@pytest.mark.parametrize("spec", ["raw:A", "single:B", "music", "amusic", "borda", "oracle"])
def test_recall_grows_with_the_list_and_begins_with_the_answers(spec: str) -> None:
    trace = trace_of(routes(7), spec)
    found = [metrics.recall_at(trace, n) for n in (1, 5, 10, 20, 30)]
    assert found == sorted(found)
    assert found[0] == trace.correct.sum() / trace.has_place.sum()


def test_nothing_ran_leaves_the_prediction_only() -> None:
    bank = routes(1)
    ran = np.zeros(2, bool)
    assert ranked(bank, 0, ran, 4).tolist() == [4]
    assert ranked(bank, 0, ran, -1).tolist() == []
    nothing, asleep = np.full(50, -1), np.zeros((50, 2), bool)
    assert not true_ranks(bank, nothing, asleep).any()
    silent = {"confidence": np.zeros(50), "similarity": np.zeros(50)}
    trace = Trace.join(
        bank, predictions=nothing, ran=asleep, policy="x", statistic="none", **silent
    )
    assert metrics.recall_at(trace, 20) == 0.0


def test_no_true_place_at_all_is_recall_0() -> None:
    scores = np.random.default_rng(0).normal(size=(1, 3, 4))
    bank = ScoreBank(scores, ["A"], [1], tolerance=0, ground_truth=np.full(3, -1))
    with pytest.warns(UserWarning, match="no correct match"):
        row = metrics.summarise(trace_of(bank, "raw:A"))
    assert [row[column] for column in metrics.RECALLS] == [0.0] * 4
    assert row["recall_at_100_precision"] == 0.0


def test_lists_are_written_line_by_line() -> None:
    bank = routes(2)
    trace = trace_of(bank, "music")
    rows = list(csv.DictReader(io.StringIO(ranked_lists(bank, trace, 4).decode())))
    assert tuple(rows[0]) == LIST_COLUMNS
    assert len(rows) == 4 * bank.queries
    for frame in range(bank.queries):
        own = rows[4 * frame : 4 * frame + 4]
        assert [int(row["query"]) for row in own] == [frame] * 4
        assert [int(row["rank"]) for row in own] == [1, 2, 3, 4]
        places = ranked(bank, frame, trace.ran[frame], int(trace.predictions[frame]), 4)
        assert [int(row["place"]) for row in own] == places.tolist()
        hits = [int(row["rank"]) for row in own if row["correct"] == "1"]
        rank = int(trace.true_rank[frame])
        assert hits[:1] == ([rank] if 0 < rank <= 4 else [])


def test_a_comparison_writes_lists_when_asked_and_takes_stale_ones_away(tmp_path) -> None:
    bank, out = routes(4), tmp_path / "out"
    said: list[str] = []

    def run(policies: list[str], top: int | None) -> set[str]:
        compare([bank], lambda bank: contestants(policies), out, top=top, report=said.append)
        return {path.name for path in (out / "lists").glob("*.csv")}

    assert run(["raw:A", "music"], 3) == {"bank-raw_A.csv", "bank-music.csv"}
    lines = (out / "lists" / "bank-raw_A.csv").read_text("utf-8").splitlines()
    assert len(lines) == 1 + 3 * bank.queries
    assert run(["music"], 2) == {"bank-music.csv"}
    assert run(["music"], None) == set()
    with pytest.raises(ValueError, match="top is 0; give a whole number >= 1"):
        run(["music"], 0)
