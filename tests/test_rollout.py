"""Rollouts: what is recorded, routes of different size in one call, and the two protocols."""

from __future__ import annotations

import numpy as np
import pytest
from amusic_baselines import make_policy
from env_cases import random_bank
from rollout_cases import Cycle, assert_same

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation.rollout import Job, rollout, rollouts
from amusic_gym.policies.protocol import Context, Localiser, Selector


class SecondBest:
    """A localiser that asks for a row twice and reports its second best place."""

    def reset(self, references, techniques):
        self.sizes = references, techniques

    def locate(self, frame, run):
        row = run(1)
        assert run(1) is not None
        return int(np.argsort(row)[-2]), float(frame)


def banks_of_all_sizes() -> list[ScoreBank]:
    return [
        random_bank(1, techniques=3, queries=40, references=60),
        random_bank(2, techniques=1, queries=1, references=1, tolerance=0),
        random_bank(3, techniques=5, queries=13, references=80),
        random_bank(4, techniques=2, queries=75, references=75),
    ]


@pytest.mark.parametrize("needs", [{}, {"reselection": 4}, {"allow_idle": True}])
@pytest.mark.parametrize("statistic", ["mean", "evidence"])
def test_routes_of_different_size_at_once_equal_one_at_a_time(needs, statistic):
    banks = banks_of_all_sizes()
    together = rollouts(
        Cycle(**needs), [Job(bank) for bank in banks], name="cycle", statistic=statistic
    )
    for bank, trace in zip(banks, together, strict=True):
        assert trace.queries == bank.queries
        assert trace.ran.shape == (bank.queries, len(bank.techniques))
        assert_same(trace, rollout(Cycle(**needs), bank, name="cycle", statistic=statistic))


def test_order_of_the_routes_does_not_matter():
    banks = banks_of_all_sizes()
    forwards = rollouts(Cycle(reselection=3), [Job(bank) for bank in banks], name="cycle")
    backwards = rollouts(Cycle(reselection=3), [Job(bank) for bank in banks[::-1]], name="cycle")
    for one, other in zip(forwards, backwards[::-1], strict=True):
        assert_same(one, other)


def test_trace_is_what_the_single_environment_says(bank):
    trace = rollout(Cycle(reselection=4), bank, name="cycle", statistic="mean")
    env = TechniqueSelectionEnv(bank, statistic="mean", reselection=4)
    env.reset(seed=0)
    policy = Cycle(reselection=4)
    info = {"frame": np.array([-1]), "present": np.ones((1, 3), np.bool_)}
    for frame in range(bank.queries):
        action = policy.act(None, {**info, "compute_weight": np.ones(1)})[0]
        _, _, terminated, _, said = env.step(action)
        assert trace.predictions[frame] == said["prediction"]
        assert trace.confidence[frame] == said["confidence"]
        assert trace.similarity[frame] == said["similarity"]
        assert trace.p_correct[frame] == said["p_correct"]
        assert trace.chosen[frame] == said["technique"]
        assert trace.ran[frame].tolist() == said["ran"].tolist()
        assert trace.late_runs[frame].tolist() == said["selection"]["late_runs"].tolist()
        assert trace.selections[frame] == said["selection"]["happened"]
        info["frame"] = np.array([said["frame"]])
    assert terminated
    assert trace.late_runs.sum() > 0


def test_policy_sees_each_routes_compute_weight_and_one_reset(bank):
    policy = Cycle()
    traces = rollouts(policy, [Job(bank, 0.25), Job(bank, 4.0), Job(bank)], name="cycle")
    assert [trace.compute_weight for trace in traces] == [0.25, 4.0, None]
    assert len(policy.resets) == 1
    assert policy.resets[0].all()
    assert np.array_equal(policy.weights, np.tile([0.25, 4.0, 1.0], (bank.queries, 1)))


def test_needs_come_before_what_the_user_chose(bank):
    own = rollout(Cycle(statistic="mean"), bank, name="cycle", statistic="evidence")
    chosen = rollout(Cycle(), bank, name="cycle", statistic="mean")
    assert own.statistic == chosen.statistic == "mean"
    assert_same(own, chosen)
    assert rollout(Cycle(), bank, name="cycle").statistic == SICSettings.statistic
    for name in ("carry", "discount"):
        few = {"candidates": 2}
        own = rollout(Cycle(**{name: False}, extra=few), bank, name="cycle", **{name: True})
        chosen = rollout(Cycle(extra=few), bank, name="cycle", **{name: False})
        assert_same(own, chosen)
        assert own.carry == chosen.carry == (name != "carry")
        default = rollout(Cycle(extra=few), bank, name="cycle")
        assert (chosen.p_correct != default.p_correct).any()
    many, few = (
        rollout(Cycle(statistic="evidence", extra=extra), bank, name="cycle")
        for extra in ({}, {"candidates": 1})
    )
    assert (few.predictions != many.predictions).any()


def test_localiser_is_charged_for_the_rows_it_asked_for(bank):
    policy = SecondBest()
    trace = rollout(policy, bank, name="second", statistic="mean")
    assert policy.sizes == (bank.references, len(bank.techniques))
    expected = [int(np.argsort(bank.row(1, q))[-2]) for q in range(bank.queries)]
    assert trace.predictions.tolist() == expected
    assert trace.confidence.tolist() == list(range(bank.queries))
    assert trace.ran.tolist() == [[False, True, False]] * bank.queries
    assert trace.runs.sum() == bank.queries
    assert np.isnan(trace.p_correct).all()
    assert trace.statistic == "none"


class Turns:
    """A localiser that asks for no, one or all rows in turn and says the same place, or none."""

    def reset(self, references, techniques):
        self.techniques = techniques

    def locate(self, frame, run):
        for technique in (range(0), range(1, 2), range(self.techniques))[frame % 3]:
            run(technique)
        return (3 if frame % 5 else -1), 9.0


def test_similarity_of_a_localiser_is_the_largest_z_score_in_the_rows_it_asked_for(bank):
    scores = bank.scores.copy()
    wide = scores.astype(float)
    at_place = (wide[:, :, 3] - wide.mean(axis=2)) / wide.std(axis=2)  # (T, Q)
    scores[1, 16], at_place[1, 16] = 0.1, 0.0  # a constant row
    bank = ScoreBank(scores, bank.techniques, bank.seconds, tolerance=1, ground_truth=bank.truth)
    trace = rollout(Turns(), bank, name="turns")
    for frame, found in enumerate(trace.similarity):
        asked = [[], [1], [0, 1, 2]][frame % 3] if frame % 5 else []
        expected = max((at_place[t, frame] for t in asked), default=0.0)
        assert found == pytest.approx(expected, abs=1e-12)
    assert (trace.similarity[1::3] < 0).any()  # a row may speak against the place


def test_protocols_tell_the_policies_apart(bank):
    context = Context.of(bank, statistic="mean")
    for name in ("music", "amusic", "oracle", "cascade", "random:0.5"):
        assert isinstance(make_policy(name, context), Selector)
    raw = make_policy("raw:T0", context)
    assert isinstance(raw, Localiser)
    assert not isinstance(raw, Selector)


def test_context_refuses_an_unknown_technique(bank):
    with pytest.raises(ValueError, match="unknown technique 't1': did you mean 'T1'"):
        Context.of(bank, statistic="mean").index("t1")


def test_a_subset_of_a_bank_is_a_bank(bank):
    part = bank.subset(["T2", "T0"])
    trace = rollout(make_policy("music", Context.of(part, statistic="evidence")), part, name="m")
    whole = rollout(
        make_policy("subset:T0+T2", Context.of(bank, statistic="evidence")), bank, name="m"
    )
    assert trace.techniques == ("T2", "T0")
    np.testing.assert_array_equal(trace.predictions, whole.predictions)
    np.testing.assert_array_equal(trace.confidence, whole.confidence)


@pytest.mark.parametrize("spec", ["raw:T1", "mpf", "switchhit:1", "borda"])
def test_13_a_localiser_is_not_fed_scores_that_are_not_finite(spec, bank, tmp_path):
    bank.save(tmp_path / "bank")
    scores = np.load(tmp_path / "bank" / "scores.npy", mmap_mode="r+")
    scores[1, 7, 3] = np.nan
    scores.flush()
    broken = ScoreBank.load(tmp_path / "bank")
    policy = make_policy(spec, Context.of(broken, statistic="evidence"))
    with pytest.raises(ValueError, match="NaN or infinite score of technique 'T1' at frame 7"):
        rollout(policy, broken, name=spec)
