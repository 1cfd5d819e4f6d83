"""Rivals of a learned selector: a fixed rhythm, value of information, and choice by chance."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from amusic_baselines import make_policy
from amusic_baselines.costs import cheapest, cost_ranks, cost_shares
from amusic_baselines.periodic import Periodic
from amusic_baselines.uniform import Uniform
from amusic_baselines.voi import ValueOfInformation, best_subset
from env_cases import random_bank
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.figure import Figure
from planted_routes import planted
from rollout_cases import assert_same
from study_cases import learned, plan_of

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.observation import TECHNIQUE_FEATURES, observation_size
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.prediction import IDLE_DECAY
from amusic_gym.evaluation import study
from amusic_gym.evaluation.comparison import compare
from amusic_gym.evaluation.contestants import contestants
from amusic_gym.evaluation.metrics import summarise
from amusic_gym.evaluation.rollout import Job, rollout, rollouts
from amusic_gym.evaluation.study.figures import draw
from amusic_gym.evaluation.study.findings import EVERYONE
from amusic_gym.evaluation.study.lineup import Lineup
from amusic_gym.policies.protocol import Context
from amusic_gym.policies.registry import CASCADE, FRONTS, MAY_IDLE, PEER, PERIODIC, VOI
from amusic_gym.routes.simulate import simulate

pytestmark = pytest.mark.slow

WEIGHTS = (0.01, 0.05, 0.15, 0.4, 1.0)


def make(spec, bank, seed=0):
    return make_policy(spec, Context.of(bank, statistic="evidence", seed=seed))


def run(spec, bank, weight=None, seed=0, **how):
    policy = make(spec, bank, seed)
    return rollout(policy, bank, name=spec, statistic="evidence", compute_weight=weight, **how)


PLAIN = {"carry": False, "discount": False}
"""On a steady route a useless technique goes on from where a good one was, if it may carry: then
nothing that is dear needs to run again."""


@pytest.fixture(scope="module")
def dear_first():
    """Three techniques, the cheapest of them in the middle."""
    scores = random_bank(3, queries=23).scores
    names, seconds = ["T0", "T1", "T2"], [3.0, 1.0, 2.0]
    return ScoreBank(scores, names, seconds, tolerance=2, ground_truth=np.arange(23), name="dear")


# ---- costs -------------------------------------------------------------------------------------


def test_costs_of_techniques_that_are_present():
    info = {
        "present": np.array([[True, True, True], [False, True, True]]),
        "run_seconds": np.array([[2.0, 1.0, 1.0], [0.0, 3.0, 1.0]]),
    }
    assert cost_ranks(info).tolist() == [[2, 0, 1], [2, 1, 0]]
    assert cheapest(info).tolist() == [[False, True, False], [False, False, True]]
    assert cost_shares(info).tolist() == [[0.5, 0.25, 0.25], [0.0, 0.75, 0.25]]


# ---- periodic ----------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [1, 2, 7, 100])
@pytest.mark.parametrize(
    ("rest", "often", "between"),
    [
        ("", [0, 1, 2], [1]),
        ("/T2", [2], [1]),
        ("/T0+T2", [0, 2], [1]),
        ("/T2/T0+T1", [2], [0, 1]),
        ("/T0/idle", [0], []),
        ("/T0+T1+T2/idle", [0, 1, 2], []),
    ],
)
def test_periodic_runs_one_subset_on_every_nth_frame(period, rest, often, between, dear_first):
    trace = run(f"periodic:{period}{rest}", dear_first)
    for frame, ran in enumerate(trace.ran):
        assert np.flatnonzero(ran).tolist() == (between if frame % period else often), frame


def test_only_a_period_that_idles_asks_for_idling(dear_first):
    for spec, idles in [("5", False), ("5/T0", False), ("5/T0/T1", False), ("5/T0/idle", True)]:
        assert make(f"periodic:{spec}", dear_first).needs.allow_idle is idles
    assert Periodic(2, [0], []).needs.allow_idle


def test_periodic_counts_the_frames_of_each_route_by_itself():
    info = {
        "frame": np.array([-1, 0, 1, 2, 5, 8]),
        "present": np.ones((6, 2), np.bool_),
        "run_seconds": np.tile([1.0, 2.0], (6, 1)),
    }
    policy = Periodic(3, [1])
    due = [[False, True], [True, False], [True, False], [False, True], [False, True], [False, True]]
    assert policy.act(None, info).tolist() == due
    policy.reset(np.array([False, True, False, False, False, False]))
    info["frame"] = np.array([0, -1, 2, 3, 6, 9])
    begun = policy.act(None, info)
    assert begun[:, 1].tolist() == [False, True, True, False, False, False]


def test_periodic_begins_anew_with_every_episode():
    banks = [random_bank(seed, queries=queries) for seed, queries in [(1, 7), (2, 10), (3, 30)]]
    env = TechniqueSelectionVectorEnv(
        3, banks, episode_length=11, random_start=True, allow_idle=True, statistic="evidence"
    )
    observation, info = env.reset(seed=4)
    policy = make("periodic:4/T2/idle", banks[0])
    policy.reset(np.ones(3, np.bool_))
    begun = np.zeros(3, np.int64)
    for _ in range(60):
        observation, _, terminated, truncated, info = env.step(policy.act(observation, info))
        policy.reset(terminated | truncated)
        for frame, ran in zip(info["frame"], info["ran"], strict=True):
            assert ran.tolist() == [False, False, frame >= 0 and frame % 4 == 0]
        begun += info["frame"] == 0
    assert (begun >= 4).all()
    env.close()


def test_the_cheapest_between_is_the_cheapest_of_each_route():
    info = {
        "frame": np.array([0, 0]),
        "present": np.array([[True, True, True], [False, True, True]]),
        "run_seconds": np.array([[1.0, 2.0, 3.0], [0.0, 4.0, 3.0]]),
    }
    action = Periodic(2, [1]).act(None, info)
    assert action.tolist() == [[True, False, False], [False, False, True]]


# ---- random that may idle ----------------------------------------------------------------------


def test_random_that_may_idle_runs_what_it_draws_and_nothing_else():
    route = random_bank(1, queries=400, references=400)
    idle, busy = run("random:0.3/idle", route, seed=5), run("random:0.3", route, seed=5)
    drawn = np.random.default_rng(5).random((400, 1, 3))[:, 0] < 0.3
    assert (idle.ran == drawn).all()
    nothing = ~drawn.any(axis=1)
    assert nothing.mean() == pytest.approx(0.7**3, abs=0.07)
    assert (busy.ran[nothing] == [True, False, False]).all()
    assert (busy.ran[~nothing] == drawn[~nothing]).all()
    assert make("random:0.3/idle", route).needs.allow_idle
    assert not make("random:0.3", route).needs.allow_idle
    assert not Uniform(0.5).needs.allow_idle


# ---- value of information: the search ----------------------------------------------------------


def value(promise, price, subset):
    """Predicted p̂ of a subset of one route, less what it costs."""
    return 1.0 - np.prod(1.0 - promise[subset]) - price[subset].sum()


def greedy(promise, price, present):
    """The search by loops, on one route."""
    subset = np.zeros(promise.size, np.bool_)
    while True:
        candidates = []
        for t in np.flatnonzero(present & ~subset):
            grown = subset.copy()
            grown[t] = True
            candidates.append((value(promise, price, grown), -t, grown))
        best = max(candidates, key=lambda one: one[:2], default=None)
        if best is None or (subset.any() and best[0] <= value(promise, price, subset) + 1e-12):
            return subset
        subset = best[2]


def test_the_search_is_greedy_and_stops_where_nothing_pays():
    rng = np.random.default_rng(0)
    promise, price = rng.random((300, 5)), rng.random((300, 5)) * rng.random((300, 1))
    present = rng.random((300, 5)) < 0.8
    present[:, 2] |= ~present.any(axis=1)
    subsets, values = best_subset(promise, price, present)
    for i in range(300):
        assert subsets[i].tolist() == greedy(promise[i], price[i], present[i]).tolist(), i
        assert values[i] == pytest.approx(value(promise[i], price[i], subsets[i]))
    sizes = subsets.sum(axis=1)
    assert sizes.min() == 1
    assert sizes.max() >= 4


@given(arrays(np.float64, (1, 4), elements=st.floats(0, 1)))
def test_no_subset_is_empty_and_free_techniques_join_while_they_add(promise):
    present = np.ones((1, 4), np.bool_)
    dear, _ = best_subset(promise, np.full((1, 4), 9.0), present)
    assert dear.sum() == 1
    assert promise[0][dear[0]] == pytest.approx(promise.max())
    _, free = best_subset(promise, np.zeros((1, 4)), present)
    assert free[0] == pytest.approx(1.0 - np.prod(1.0 - promise))


def test_the_lower_index_among_equals():
    subset, _ = best_subset(np.full((1, 3), 0.5), np.full((1, 3), 0.3), np.ones((1, 3), np.bool_))
    assert subset.tolist() == [[True, False, False]]


# ---- value of information: the records ---------------------------------------------------------


class Told:
    """Observations and infos of routes as the test makes them up."""

    def __init__(self, seconds, weight=0.2):
        self.seconds = np.array(seconds, np.float64)
        self.weight = weight

    def __call__(self, frame, p_correct, ran, agrees):
        ran, agrees = np.array(ran, np.bool_), np.array(agrees, np.float32)
        observation = np.zeros((len(ran), observation_size(ran.shape[1])), np.float32)
        at = TECHNIQUE_FEATURES.index("agrees")
        observation[:, at : ran.shape[1] * len(TECHNIQUE_FEATURES) : len(TECHNIQUE_FEATURES)] = (
            agrees
        )
        info = {
            "frame": np.full(len(ran), frame),
            "p_correct": np.array(p_correct, np.float64),
            "present": np.ones(ran.shape, np.bool_),
            "run_seconds": self.seconds,
            "ran": ran,
            "compute_weight": np.full(len(ran), self.weight),
        }
        return observation, info


def test_a_record_is_what_p_leaves_to_the_technique():
    told = Told([[1.0, 1.0, 1.0, 1.0]])
    policy = ValueOfInformation(keep=0.9, lasting=1.0)
    policy.reset(np.array([True]))
    policy.act(*told(-1, [0.0], [[0, 0, 0, 0]], [[0, 0, 0, 0]]))
    assert policy.promise(np.array([-1])).tolist() == [[1.0] * 4]
    policy.act(*told(0, [0.8], [[1, 1, 0, 0]], [[1, 0, 1, 0]]))
    # agrees: p̂; does not: what p̂ leaves; did not run: as before
    assert policy.promise(np.array([0])) == pytest.approx(np.array([[0.98, 0.92, 1.0, 1.0]]))
    policy.act(*told(1, [0.3], [[1, 1, 0, 1]], [[1, 0, 1, 0]]))
    second = [0.9 * 0.98 + 0.03, 0.9 * 0.92 + 0.03, 1.0, 0.93]
    assert policy.promise(np.array([1])) == pytest.approx(np.array([second]))


def test_what_has_not_run_for_long_is_as_good_as_new():
    told = Told([[1.0, 1.0]])
    policy = ValueOfInformation(keep=0.0, lasting=0.9)
    policy.reset(np.array([True]))
    policy.act(*told(3, [0.4], [[1, 0]], [[1, 0]]))
    policy.act(*told(4, [0.2], [[0, 1]], [[0, 1]]))
    promise = policy.promise(np.array([5]))
    assert promise == pytest.approx(np.array([[1 - 0.6 * 0.9**2, 1 - 0.8 * 0.9]]))
    assert policy.promise(np.array([200])) == pytest.approx(np.ones((1, 2)))


def test_records_belong_to_a_route_and_are_forgotten_with_it():
    told = Told([[1.0, 1.0]] * 3)
    policy = ValueOfInformation(keep=0.5, lasting=1.0)
    policy.reset(np.ones(3, np.bool_))
    policy.act(*told(0, [0.2, 0.6, 0.2], [[1, 0]] * 3, [[1, 0]] * 3))
    assert policy.promise(np.zeros(3, np.int64))[:, 0] == pytest.approx([0.6, 0.8, 0.6])
    policy.reset(np.array([True, False, False]))
    policy.act(*told(1, [0.0] * 3, [[0, 0]] * 3, [[0, 0]] * 3))
    assert policy.promise(np.ones(3, np.int64))[:, 0] == pytest.approx([1.0, 0.8, 0.6])


def test_it_idles_where_the_decay_of_p_costs_less_than_any_run():
    told = Told([[1.0, 1.0]], weight=1.0)  # each costs a half of p̂ and is predicted to give 1
    policy = ValueOfInformation(idle=True)
    policy.reset(np.array([True]))
    assert policy.act(*told(-1, [0.0], [[0, 0]], [[0, 0]])).tolist() == [[True, False]]
    high, low = 0.51 / IDLE_DECAY, 0.49 / IDLE_DECAY
    assert policy.act(*told(0, [high], [[0, 0]], [[0, 0]])).tolist() == [[False, False]]
    assert policy.act(*told(1, [low], [[0, 0]], [[0, 0]])).tolist() == [[True, False]]
    busy = ValueOfInformation()
    busy.reset(np.array([True]))
    assert busy.act(*told(0, [high], [[0, 0]], [[0, 0]])).tolist() == [[True, False]]
    assert (policy.needs.allow_idle, busy.needs.allow_idle) == (True, False)


def test_on_the_first_frame_something_runs_however_dear(dear_first):
    for spec in ("voi:100", "voi:100/idle"):
        assert run(spec, dear_first).ran[0].sum() == 1


# ---- value of information on routes ------------------------------------------------------------


def good_ones(bank, length=100):
    """Which technique is right most often in each regime, each frame by itself."""
    truth, frames = bank.truth.matrix(), np.arange(bank.queries)
    right = np.array([truth[frames, row.argmax(axis=1)] for row in np.asarray(bank.scores)])
    return right.reshape(len(right), -1, length).mean(axis=2).argmax(axis=0)


@pytest.mark.parametrize("statistic", ["evidence", "belief"])
@pytest.mark.parametrize("seed", [0, 3])
def test_it_finds_the_one_good_technique_of_every_regime(seed, statistic):
    route = planted(seed)
    good = good_ones(route)
    assert sorted(good) == [0, 1, 2, 3]

    def drive(spec, weight=None):
        policy = make_policy(spec, Context.of(route, statistic=statistic, **PLAIN))
        how = {"statistic": statistic, **PLAIN}
        return rollout(policy, route, name=spec, compute_weight=weight, **how)

    trace, everything = drive("voi", 0.15), summarise(drive("music"))
    settled = np.arange(400).reshape(4, 100)[:, 40:]
    for regime, technique in zip(settled, good, strict=True):
        share = trace.ran[regime].mean(axis=0)
        if statistic == "evidence":  # to the belief, a good row now and then is enough
            assert share[technique] > 0.85
            assert np.delete(share, technique).max() < 0.15
    assert trace.ran.any(axis=0).all()  # each has been tried
    row = summarise(trace)
    assert row["compute"] < 0.4
    assert row["accuracy"] > everything["accuracy"] - 0.02
    assert_same(trace, drive("voi", 0.15))


@pytest.mark.filterwarnings("ignore:.*has no correct match")  # at a λ for which it soon idles
@pytest.mark.parametrize("spec", ["voi", "voi:idle"])
def test_a_larger_compute_weight_is_never_dearer(spec):
    routes = [planted(0), planted(3, regimes=2), *map(simulate, range(2, 12))]
    jobs = [Job(route, weight) for route in routes for weight in WEIGHTS]
    traces = rollouts(make(spec, routes[0]), jobs, name=spec, statistic="evidence", **PLAIN)
    compute = np.reshape([summarise(trace)["compute"] for trace in traces], (len(routes), -1))
    assert (np.diff(compute.mean(axis=0)) < 0.0).all()
    assert compute[:, 0].mean() > 2.5 * compute[:, -1].mean()
    # On one route a little by chance; and once more than that: as it learns about the techniques
    # while it drives, a weight may settle on a dearer one that does as well.
    assert (np.diff(compute, axis=1) > 0.03).sum() <= 1
    # Not by how much: on some the techniques cost alike, or the cheapest will do at any weight.
    assert (compute[:, 0] > compute[:, -1]).all()


@pytest.mark.parametrize("idle", ["", "/idle"])
def test_a_weight_of_its_own_is_heeded_whatever_the_environment_s(idle):
    route = planted(1, regimes=2)
    own = run(f"voi:0.3{idle}", route, weight=5.0)
    swept = run("voi:idle" if idle else "voi", route, weight=0.3)
    assert (own.ran == swept.ran).all()
    other = run("voi:idle" if idle else "voi", route, weight=5.0)
    assert (own.ran != other.ran).any()


def test_routes_of_one_batch_weigh_compute_each_by_its_own_weight():
    route = planted(2, regimes=2)
    jobs = [Job(route, weight) for weight in WEIGHTS]
    together = rollouts(make("voi", route), jobs, name="voi", statistic="evidence", **PLAIN)
    for weight, trace in zip(WEIGHTS, together, strict=True):
        assert_same(trace, run("voi", route, weight=weight, **PLAIN))
    assert all((one.ran != other.ran).any() for one, other in pairwise(together))


# ---- in comparisons and studies ----------------------------------------------------------------


def test_what_reads_the_compute_weight_has_a_row_for_each(tmp_path):
    specs = ["voi", "voi:idle", "voi:0.2", "periodic:3", "random:0.5/idle"]
    made = contestants(specs, compute_weights=(0.1, 1.0))
    swept = {one.name: one.compute_weights for one in made}
    assert swept == {
        "voi": (0.1, 1.0),
        "voi:idle": (0.1, 1.0),
        "voi:0.2": (None,),
        "periodic:3": (None,),
        "random:0.5/idle": (None,),
    }
    result = compare([random_bank(1)], lambda bank: made, tmp_path, report=len)
    assert [(row["policy"], row["compute_weight"]) for row in result.rows[:4]] == [
        *(("voi", 0.1), ("voi", 1.0)),
        *(("voi:idle", 0.1), ("voi:idle", 1.0)),
    ]
    assert result.rows[-1]["idle"] > 0


def test_a_study_knows_their_families():
    lineup = Lineup(
        policies=("periodic:5", "periodic:5/A/idle", "voi", "voi:0.3/idle", "cascade", "hmm"),
        selectors={},
        all_subsets=False,
        insisted={},
        compute_weights=(0.3, 1.0),
    )
    entrants = lineup.entrants(["A", "B"])
    assert [one.family for one in entrants] == [*(PERIODIC, MAY_IDLE, VOI, MAY_IDLE, CASCADE, PEER)]
    rules = {PERIODIC, VOI, MAY_IDLE}
    assert rules <= set(FRONTS)  # so they are rivals of what is learned


def test_a_rule_with_compute_weights_is_a_line_and_a_rival(tmp_path, monkeypatch):
    specs = ("voi", "voi:idle", "periodic:2/T0", "periodic:4/T0/idle")
    lineup = Lineup(specs, {}, True, {}, (0.1, 1.0))
    everybody = [*lineup.entrants(["T0", "T1", "T2"]), learned("PPO", seeds=1)]
    route = random_bank(1, queries=30, references=40)
    plan = plan_of(everybody, [route], seeds=(0,), conditions=("recorded",))
    findings = study.find(plan, study.run(plan, tmp_path, report=len))
    rivals = [row["rival"] for row in findings.margins]
    assert rivals == ["fixed subsets", "value of information", "may idle", "periodic", EVERYONE]
    written, save = [], Figure.savefig

    def keep(figure, *arguments, **options):
        written.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", keep)
    draw(findings, tmp_path)
    lines = {line.get_label(): line for line in written[0].axes[0].get_lines()}
    swept, idle = lines["value of information"], lines["value of information, may idle"]
    assert [len(line.get_xdata()) for line in (swept, idle)] == [2, 2]
    assert [line.get_linestyle() for line in (swept, idle)] == ["-", "--"]
    for one in ("T0 every 2 frames", "T0 every 4 frames, else idle"):
        assert len(lines[one].get_xdata()) == 1
