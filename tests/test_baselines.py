"""Every policy of the registry keeps the contract; each does what its name says."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
import oracle as loops
import pytest
from amusic_baselines import POLICIES, make_policy
from amusic_baselines.cascade import Cascade
from amusic_baselines.uniform import Uniform
from env_cases import random_bank
from rollout_cases import assert_same

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.settings import BLOCK, COVERAGE, STATISTICS, SICSettings
from amusic_gym.evaluation.metrics import summarise
from amusic_gym.evaluation.rollout import Job, rollout, rollouts
from amusic_gym.policies.protocol import Context, Selector
from amusic_gym.policies.trace import Trace

pytestmark = pytest.mark.slow

ARGUMENTS = {
    "raw": ["T1"],
    "single": ["T2"],
    "subset": ["T0+T2", "T1"],
    "music": [None],
    "amusic": [None, "evidence", "mean", "belief"],
    "random": ["0.4", "0", "1", "0.4/idle"],
    "periodic": ["3", "4/T1+T2", "4/T2/T0+T1", "4/T1/idle"],
    "cascade": [None, "1/5/0.4", "1/5/margin=2"],
    "voi": [None, "idle", "0.2", "0.2/idle"],
    "oracle": [None],
    "mpf": [None, "5"],
    "hmpf": [None],
    "dynmpf": [None, "5"],
    "switchhit": [None, "0.4"],
    "plurality": [None],
    "borda": [None, "60"],
    "hmm": [None, "0.3/0.02"],
    "xu": [None],
    "lazygraph": [None],
}
SPECS = [
    name if argument is None else f"{name}:{argument}"
    for name, arguments in ARGUMENTS.items()
    for argument in arguments
]
DEFAULT = SICSettings.statistic
ONE_ROUTE = ("oracle",)  # built for the bank they run on
DRAWING = ("random",)
LOCALISERS = (
    "raw",
    "mpf",
    "hmpf",
    "dynmpf",
    "switchhit",
    "plurality",
    "borda",
    "hmm",
    "xu",
    "lazygraph",
)


def make(spec: str, bank: ScoreBank, statistic: str = DEFAULT, seed: int = 0):
    return make_policy(spec, Context.of(bank, statistic=statistic, seed=seed))


def run(
    spec: str, bank: ScoreBank, statistic: str = DEFAULT, seed: int = 0, plain: bool = False
) -> Trace:
    """A policy's trace; ``plain``: without carried candidates and the discount."""
    how = {"carry": False, "discount": False} if plain else {}
    policy = make_policy(spec, Context.of(bank, statistic=statistic, seed=seed, **how))
    return rollout(policy, bank, name=spec, statistic=statistic, **how)


def loops_how(statistic: str, plain: bool) -> dict[str, Any]:
    """The same for the explicit loops."""
    ours = statistic == "evidence" and not plain
    return {"statistic": statistic, "carry": ours, "discount": ours}


HOW = [("mean", False), ("evidence", False), ("evidence", True)]
"""Statistic, and whether it is plain."""


def kind(spec: str) -> str:
    return spec.partition(":")[0]


def may_idle(spec: str) -> bool:
    return spec.endswith("idle")


# ---- the contract, for every line of the registry --------------------------------------------


def test_every_policy_of_the_registry_is_tested():
    assert list(ARGUMENTS) == list(POLICIES)


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("spec", SPECS)
def test_gives_a_trace_of_the_whole_route(spec, statistic, bank):
    trace = run(spec, bank, statistic)
    assert (trace.policy, trace.bank, trace.compute_weight) == (spec, bank.name, None)
    assert trace.queries == bank.queries
    began = np.logical_or.accumulate(trace.ran.any(axis=1))
    assert ((trace.predictions >= 0) == began).all()
    assert (trace.predictions < bank.references).all()
    running = trace.ran.any(axis=1)
    assert running.any() if may_idle(spec) else running.all()
    spent = trace.runs.sum(axis=0) @ bank.seconds
    row = summarise(trace)
    assert row["compute"] == pytest.approx(spent / (bank.queries * bank.seconds.sum()))
    if kind(spec) not in LOCALISERS:
        assert ((trace.p_correct >= 0) & (trace.p_correct <= 1)).all()
        assert trace.ran[running, trace.chosen[running]].all()  # MuSIC trusts what ran
        assert (trace.chosen[~running] == -1).all()


@pytest.mark.parametrize("spec", SPECS)
def test_the_same_again(spec, bank):
    assert_same(run(spec, bank), run(spec, bank))


@pytest.mark.parametrize("spec", [spec for spec in SPECS if kind(spec) not in DRAWING])
def test_a_used_policy_forgets_when_reset(spec, bank):
    policy = make(spec, bank)
    first, second = (rollout(policy, bank, name=spec) for _ in range(2))
    assert_same(first, second)


@pytest.mark.parametrize("spec", [spec for spec in SPECS if kind(spec) not in LOCALISERS])
@pytest.mark.parametrize("routes", [1, 3])
def test_actions_are_in_the_action_space(spec, routes, bank):
    if kind(spec) in ONE_ROUTE and routes > 1:
        with pytest.raises(ValueError, match="knows one route, not 3; run one at a time"):
            make(spec, bank).reset(np.ones(routes, np.bool_))
        return
    policy = make(spec, bank)
    assert isinstance(policy, Selector)
    needs = policy.needs
    env = TechniqueSelectionVectorEnv(
        routes,
        bank,
        statistic=needs.statistic or DEFAULT,
        reselection=needs.reselection,
        coverage=needs.coverage,
        allow_idle=needs.allow_idle,
    )
    observation, info = env.reset(seed=0)
    policy.reset(np.ones(routes, np.bool_))
    for _ in range(bank.queries):
        actions = policy.act(observation, info)
        assert env.action_space.contains(actions.astype(np.int8))
        observation, _, _, _, info = env.step(actions)


@pytest.mark.parametrize(
    "spec", [spec for spec in SPECS if kind(spec) not in (*ONE_ROUTE, *DRAWING)]
)
def test_several_routes_at_once_equal_one_at_a_time(spec):
    banks = [
        random_bank(seed, queries=queries, references=references)
        for seed, queries, references in [(1, 40, 60), (2, 25, 30), (3, 70, 75), (4, 9, 40)]
    ]
    together = rollouts(make(spec, banks[0]), [Job(bank) for bank in banks], name=spec)
    for bank, trace in zip(banks, together, strict=True):
        assert_same(trace, run(spec, bank))


@pytest.mark.parametrize(
    "spec", ["music", "amusic", "cascade", "random:0.5", "oracle", "periodic:3", "voi", "voi:idle"]
)
def test_runs_on_one_technique_one_frame_one_place(spec):
    tiny = ScoreBank([[[1.0]]], ["only"], [2.0], tolerance=0, name="dot")
    trace = run(spec, tiny)
    assert trace.predictions.tolist() == [0]
    assert trace.ran.tolist() == [[True]]


@pytest.mark.parametrize(
    ("spec", "sentence"),
    [
        ("amusci", r"unknown policy 'amusci': did you mean 'amusic'\? valid: raw, single, "),
        ("", "unknown policy '': valid: raw, single, subset, music, amusic, random, periodic"),
        ("AMUSIC", "unknown policy 'AMUSIC': did you mean 'amusic'"),
        ("ppu", "unknown policy 'ppu': did you mean 'ppo'"),
        ("raw", "policy 'raw' needs an argument; write raw:NAME"),
        ("raw:", "policy 'raw' needs an argument; write raw:NAME"),
        ("single", "policy 'single' needs an argument; write single:NAME"),
        ("subset:", r"policy 'subset' needs an argument; write subset:A\+B"),
        ("random", "policy 'random' needs an argument; write random:P"),
        ("raw:t1", r"unknown technique 't1': did you mean 'T1'\? valid: T0, T1, T2"),
        ("single:T", "unknown technique 'T': did you mean 'T"),
        ("subset:T0+U2", r"unknown technique 'U2': did you mean 'T2'\? valid: T0, T1, T2"),
        ("subset:T0+T0", r"subset:T0\+T0 names a technique twice; name each once"),
        ("subset:T0+", "unknown technique ''"),
        ("music:T0", "policy 'music' takes no argument, got 'T0'; write music"),
        ("cascade:3", "cascade:3 is not of the form cascade:CHEAP/HOLD/THRESHOLD; write it so"),
        ("oracle:", "policy 'oracle' takes no argument, got ''; write oracle"),
        ("amusic:evidance", r"unknown statistic of amusic 'evidance': did you mean 'evidence'\?"),
        ("amusic:", "unknown statistic of amusic ''"),
        ("amusic:mean/1/0.7", "amusic:mean/1/0.7: M is '1'; give a whole number from 2 to 1000"),
        ("amusic:mean/10/2", "amusic:mean/10/2: E is '2'; give a number in \\[0, 1\\]"),
        ("amusic:mean/10", "amusic:mean/10 is not of the form amusic:STATISTIC/M/E"),
        ("random:1.5", r"random:1.5: '1.5' is no probability; give a number in \[0, 1\]"),
        ("random:-0.1", "'-0.1' is no probability"),
        ("random:nan", "'nan' is no probability"),
        ("random:half", "'half' is no probability"),
        ("random:half/idle", "'half' is no probability"),
        ("random:0.5/idel", r"random:0.5/idel is not of the form random:P\[/idle\]; write it so"),
        ("random:0.5/", r"random:0.5/ is not of the form random:P\[/idle\]"),
        ("periodic", r"policy 'periodic' needs an argument; write periodic:N\[/A\+B\[/C\]\]"),
        ("periodic:0", "periodic:0: N is '0'; give a whole number from 1 to 1000000"),
        ("periodic:T1", "periodic:T1: N is 'T1'; give a whole number"),
        ("periodic:2.5/T1", "N is '2.5'; give a whole number"),
        ("periodic:5/T3", "unknown technique 'T3': did you mean 'T"),
        ("periodic:5/", "unknown technique ''"),
        ("periodic:5/idle", "unknown technique 'idle'"),
        ("periodic:5/T1/idel", "unknown technique 'idel'"),
        ("periodic:5/T1+T1/T0", r"periodic:5/T1\+T1/T0 names a technique twice; name each once"),
        (
            "periodic:5/T1/T0/T2",
            r"periodic:5/T1/T0/T2 is not of the form periodic:N\[/A\+B\[/C\]\]",
        ),
        ("voi:", "voi:: LAMBDA is ''; give a number >= 0"),
        ("voi:-1", "voi:-1: LAMBDA is '-1'; give a number >= 0"),
        ("voi:nan/idle", "LAMBDA is 'nan'; give a number >= 0"),
        ("voi:0.2/idel", "voi:0.2/idel is not of the form voi:LAMBDA, voi:idle or voi:LAMBDA/idle"),
    ],
)
def test_10_unknown_names_and_arguments_are_refused(spec, sentence, bank):
    with pytest.raises(ValueError, match=sentence):
        make(spec, bank)


# ---- each policy ---------------------------------------------------------------------------


@pytest.mark.parametrize("technique", range(3))
def test_raw_is_the_best_score_of_every_row(technique, bank):
    trace = run(f"raw:T{technique}", bank)
    expected = loops.uncorrected(bank.scores, technique)
    assert trace.predictions.tolist() == expected.predictions
    assert trace.confidence.tolist() == expected.confidences
    np.testing.assert_allclose(trace.similarity, expected.similarities, rtol=1e-9)
    assert trace.ran.tolist() == expected.ran


@pytest.mark.parametrize(("statistic", "plain"), HOW)
@pytest.mark.parametrize(
    ("spec", "active"), [("single:T1", [1]), ("subset:T0+T2", [0, 2]), ("music", [0, 1, 2])]
)
def test_fixed_subsets_are_the_loops(spec, active, statistic, plain, bank):
    trace = run(spec, bank, statistic, plain=plain)
    expected = loops.always(bank.scores, active, **loops_how(statistic, plain))
    assert trace.predictions.tolist() == expected.predictions
    assert trace.chosen.tolist() == expected.chosen
    np.testing.assert_allclose(trace.confidence, expected.confidences, rtol=1e-9)
    np.testing.assert_allclose(trace.similarity, expected.similarities, rtol=1e-9, atol=1e-9)
    assert trace.ran.tolist() == expected.ran


def test_order_of_a_subset_does_not_matter(bank):
    first, *others = (run(f"subset:{'+'.join(p)}", bank) for p in permutations(bank.techniques))
    for other in others:
        assert_same(first, other)
    assert_same(first, run("music", bank))
    assert_same(run("single:T1", bank), run("subset:T1", bank))


@pytest.mark.parametrize("statistic", STATISTICS)
def test_amusic_brings_its_own_statistic(statistic, bank):
    assert run("amusic", bank, statistic).statistic == "mean"
    assert run("amusic:evidence", bank, statistic).statistic == "evidence"
    assert_same(run("amusic", bank), run("amusic:mean", bank))
    assert_same(run("amusic", bank), run(f"amusic:mean/{BLOCK}/{COVERAGE}", bank))
    assert run("amusic:mean/5/1", bank).ran.sum() != run("amusic", bank).ran.sum()


@pytest.mark.parametrize(
    ("spec", "statistic", "plain"),
    [
        ("amusic", "mean", False),
        ("amusic", "mean", True),
        ("amusic:evidence", "evidence", False),
        ("amusic:evidence", "evidence", True),
    ],
)
def test_amusic_is_the_rule_of_the_loops(spec, statistic, plain):
    route = random_bank(7, techniques=4, queries=90, references=110)
    trace = run(spec, route, plain=plain)
    expected = loops.amusic(route.scores, **loops_how(statistic, plain))
    assert trace.predictions.tolist() == expected.predictions
    assert trace.ran.tolist() == expected.ran
    assert trace.runs.sum(axis=0).tolist() == expected.runs()
    before = [selection.frame for selection in expected.selections]
    assert np.flatnonzero(trace.selections).tolist() == before
    assert summarise(trace)["reselections"] == expected.reselections()


def test_random_draws_by_its_seed_and_probability():
    route = random_bank(1, queries=400, references=400)
    same, again, other = (run("random:0.3", route, seed=seed) for seed in (5, 5, 6))
    assert_same(same, again)
    assert (same.ran != other.ran).any()
    # 0.3 of the runs, and the cheapest where none was drawn
    assert same.ran[:, 1:].mean() == pytest.approx(0.3, abs=0.05)
    assert same.ran[:, 0].mean() == pytest.approx(0.3 + 0.7**3, abs=0.07)
    assert run("random:1", route).ran.all()
    assert run("random:0", route).ran.tolist() == [[True, False, False]] * 400


def test_random_takes_a_probability_per_technique(bank):
    trace = rollout(Uniform(np.array([0.0, 1.0, 0.0])), bank, name="often")
    assert trace.ran.tolist() == [[False, True, False]] * bank.queries


class Doubts:
    """Infos of routes whose p̂ the test decides."""

    def __init__(self, seconds, present=None) -> None:
        self.seconds = np.array(seconds, np.float64)
        self.present = np.ones(self.seconds.shape, np.bool_) if present is None else present

    def __call__(self, frame, *p_correct):
        return {
            "frame": np.full(len(p_correct), frame),
            "p_correct": np.array(p_correct),
            "present": np.array(self.present),
            "run_seconds": self.seconds,
        }


def test_cascade_holds_the_dear_ones_for_some_frames_after_a_doubt():
    doubts = Doubts([[5.0, 1.0, 3.0, 2.0]])
    cascade = Cascade(cheap=2, hold=3, threshold=0.5)
    cascade.reset(np.array([True]))
    cheap, everything = [False, True, False, True], [True] * 4
    # p̂ before any frame says nothing; 0.5 is no doubt; a second doubt begins the hold anew
    estimates = [0.0, 0.9, 0.5, 0.49, 0.9, 0.9, 0.9, 0.9, 0.1, 0.9, 0.1, 0.9, 0.9, 0.9]
    expected = "cccaaacc" + "aaaaac"
    for frame, (p, name) in enumerate(zip(estimates, expected, strict=True), -1):
        action = cascade.act(None, doubts(frame, p))[0].tolist()
        assert action == {"c": cheap, "a": everything}[name], frame


def test_cascade_doubts_each_route_by_itself_and_forgets_the_masked():
    doubts = Doubts([[1.0, 2.0, 3.0]] * 3)
    cascade = Cascade(cheap=1, hold=5)
    cascade.reset(np.ones(3, np.bool_))
    actions = cascade.act(None, doubts(4, 0.2, 0.9, 0.2))
    assert actions.sum(axis=1).tolist() == [3, 1, 3]
    cascade.reset(np.array([True, False, False]))
    assert cascade.act(None, doubts(5, 0.9, 0.9, 0.9)).sum(axis=1).tolist() == [1, 1, 3]


def test_cascade_runs_no_absent_technique_and_counts_none_as_cheap():
    present = np.array([[False, True, True, True], [True, False, False, False]])
    doubts = Doubts([[0.0, 9.0, 1.0, 2.0], [4.0, 0.0, 0.0, 0.0]], present)
    cascade = Cascade(cheap=2, hold=1)
    cascade.reset(np.ones(2, np.bool_))
    calm = cascade.act(None, doubts(3, 0.9, 0.9))
    assert calm.tolist() == [[False, False, True, True], [True, False, False, False]]
    assert np.array_equal(cascade.act(None, doubts(4, 0.1, 0.1)), present)


def test_cascade_on_a_route_runs_more_where_the_estimate_is_low():
    trace = run("cascade", random_bank(7))
    low = np.flatnonzero(trace.p_correct[:-1] < 0.5)
    assert 0 < low.size
    assert trace.ran[low + 1].all()
    assert not trace.ran.all()
    assert trace.ran[:, :2].all()  # the two cheapest


@pytest.mark.parametrize(("statistic", "plain"), HOW)
@pytest.mark.parametrize("seconds", [(1.0, 2.0, 3.0), (3.0, 1.0, 1.0)])
def test_oracle_runs_the_cheapest_technique_that_is_right(statistic, plain, seconds):
    scores = random_bank(5, queries=40).scores
    bank = ScoreBank(
        scores,
        ["T0", "T1", "T2"],
        seconds,
        tolerance=1,
        name="route",
        ground_truth=np.arange(scores.shape[1]),
    )
    truth = bank.truth.matrix()
    z = loops.standardise_bank(scores)
    cheapest_first = sorted(range(3), key=lambda t: (seconds[t], t))
    ran = [[False] * 3 for _ in range(bank.queries)]
    memory, settings = loops.Memory.of(3), (50, 1000, 1.0, statistic, z)
    how = [loops_how(statistic, plain)[name] for name in ("carry", "discount")]
    for q in range(bank.queries):
        results = []
        for t in cheapest_first:
            alone = [*ran[:q], [other == t for other in range(3)]]
            results.append(loops.music(scores, alone, q, *settings, *how, memory))
        best = next((one for one in results if truth[q, one.place]), results[0])
        ran[q][best.technique] = True
        memory.note(best, q)
    trace = run("oracle", bank, statistic, plain=plain)
    assert trace.ran.tolist() == ran
    assert len({tuple(frame) for frame in ran}) > 1  # one alone is not enough


@pytest.mark.parametrize("seconds", [(1.0, 2.0, 3.0), (3.0, 1.0, 1.0)])
def test_oracle_of_the_belief_runs_the_cheapest_technique_that_is_right(seconds):
    scores = random_bank(5, queries=40).scores
    bank = ScoreBank(
        scores,
        ["T0", "T1", "T2"],
        seconds,
        tolerance=1,
        name="route",
        ground_truth=np.arange(scores.shape[1]),
    )
    truth, one = bank.truth.matrix(), np.eye(3, dtype=np.bool_)
    cheapest_first = sorted(range(3), key=lambda t: (seconds[t], t))
    env = TechniqueSelectionEnv(bank, statistic="belief")
    chosen, right_ones = [], []
    for q in range(bank.queries):
        right = []
        for t in cheapest_first:
            env.reset(seed=0)
            info = [env.step(one[u])[4] for u in (*chosen, t)][-1]
            if truth[q, info["prediction"]]:
                right.append(t)
        chosen.append((right or cheapest_first)[0])
        right_ones.append(len(right))
    trace = run("oracle", bank, "belief")
    assert trace.ran.tolist() == one[chosen].tolist()
    assert trace.correct.tolist() == [count > 0 for count in right_ones]
    assert len(set(chosen)) > 1  # one alone is not enough
    assert 0 in right_ones  # and sometimes none is right


@pytest.mark.parametrize("statistic", STATISTICS)
def test_oracle_is_as_right_as_its_choice_allows(bank, statistic):
    trace = run("oracle", bank, statistic)
    assert trace.correct.mean() >= max(
        run(f"single:T{t}", bank, statistic).correct.mean() for t in range(3)
    )
    assert (trace.ran.sum(axis=1) == 1).all()
