"""Peers: a contract for every policy of the registry, and each peer against plain loops."""

from __future__ import annotations

import math
from itertools import combinations, product

import numpy as np
import oracle as loops
import pytest
from amusic_baselines import POLICIES, make_policy
from amusic_baselines.borda import Borda, points
from amusic_baselines.cascade import Cascade
from amusic_baselines.dynmpf import DynamicFusion, subsets
from amusic_baselines.hmm import MOVES, MarkovFilter, advance
from amusic_baselines.hmpf import fuse, tiers_by_cost
from amusic_baselines.mpf import (
    MultiProcessFusion,
    dissenter,
    observations,
    ratio,
    sequence_start,
    viterbi,
)
from amusic_baselines.plurality import count_votes
from amusic_baselines.scores import scaled, standardised
from amusic_baselines.switchhit import Experience, SwitchHit, simulated
from env_cases import noisy_bank, random_bank
from live_cases import pair
from rollout_cases import assert_same, localise, rows_of

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.metrics import summarise
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context, Localiser
from amusic_gym.policies.registry import parse

pytestmark = pytest.mark.slow

SPECS = [
    *("raw:T1", "single:T0", "subset:T0+T2", "music", "amusic", "amusic:evidence", "random:0.5"),
    *("cascade", "cascade:1/5/0.4", "cascade:1/3/p=0.9", "cascade:2/5/margin=1.5", "oracle"),
    *("mpf", "mpf:3", "hmpf", "dynmpf", "dynmpf:4", "switchhit", "switchhit:0.4", "switchhit:1"),
    *("periodic:3", "periodic:4/T1+T2/T0", "voi", "voi:0.2"),
    *("plurality", "borda", "borda:60", "hmm", "hmm:0.2/0.05"),
    *("xu", "xu:0/2/50", "lazygraph", "lazygraph:3/0.5/4"),
]
ALL_ROWS = ("mpf", "hmpf", "dynmpf", "plurality", "borda", "hmm")  # run every technique, always
PEERS = [
    spec for spec in SPECS if spec.partition(":")[0] in (*ALL_ROWS, "switchhit", "xu", "lazygraph")
]


def make(spec, bank, seed=4):
    return make_policy(spec, Context.of(bank, statistic="evidence", seed=seed))


def run(spec, bank):
    return rollout(make(spec, bank), bank, name=spec, statistic="evidence")


@pytest.fixture(scope="module")
def four():
    """Four techniques of different skill and cost, not in order of cost."""
    bank = random_bank(5, techniques=4, queries=50, references=70, levels=300)
    return ScoreBank(
        bank.scores,
        bank.techniques,
        [2.0, 0.5, 3.0, 1.0],
        tolerance=2,
        name="four",
        ground_truth=np.arange(bank.queries),
    )


# ---- the contract, for every line of the registry ------------------------------------------------


def test_every_policy_of_the_registry_is_here():
    assert {spec.partition(":")[0] for spec in SPECS} == set(POLICIES)


@pytest.mark.parametrize("spec", SPECS)
def test_valid_places_and_every_run_is_charged(spec, four):
    trace = run(spec, four)
    assert ((trace.predictions >= 0) & (trace.predictions < four.references)).all()
    assert np.isfinite(trace.confidence).all()
    assert trace.ran.any(axis=1).all()
    spent = trace.runs.sum(axis=0) @ four.seconds
    row = summarise(trace)
    assert row["compute"] == pytest.approx(spent / (four.queries * four.seconds.sum()))
    assert trace.ran.all() or spec.partition(":")[0] not in ALL_ROWS


@pytest.mark.parametrize("spec", [*PEERS, "raw:T1"])
def test_charged_are_the_rows_that_it_asked_for(spec, four):
    policy, trace = make(spec, four), run(spec, four)
    assert isinstance(policy, Localiser)
    assert trace.statistic == "none"
    policy.reset(four.references, 4)
    for frame in range(four.queries):
        one, asked = rows_of(four, frame)
        place, confidence = policy.locate(frame, one)
        assert (place, confidence) == (trace.predictions[frame], trace.confidence[frame])
        assert sorted(asked) == np.flatnonzero(trace.ran[frame]).tolist()  # none twice
        assert type(place) is int
        assert type(confidence) is float


@pytest.mark.parametrize("spec", SPECS)
def test_the_future_does_not_change_the_past(spec, four):
    now = 30
    scores = four.scores.copy()
    scores[:, now:] = np.random.default_rng(8).normal(size=scores[:, now:].shape)
    other = ScoreBank(
        scores,
        four.techniques,
        four.seconds,
        tolerance=2,
        name="other",
        ground_truth=np.arange(scores.shape[1]),
    )
    one, two = run(spec, four), run(spec, other)
    for name in ("predictions", "confidence", "ran"):
        first, second = getattr(one, name), getattr(two, name)
        np.testing.assert_array_equal(first[:now], second[:now], name)
    assert (one.confidence[now:] != two.confidence[now:]).any()  # places may be carried through


@pytest.mark.parametrize("spec", SPECS)
def test_the_same_again_and_after_a_reset(spec, four):
    first = run(spec, four)
    assert_same(first, run(spec, four))
    if not spec.startswith("random"):  # whose draws go on
        policy = make(spec, four)
        for _ in range(2):
            again = rollout(policy, four, name=spec, statistic="evidence")
            assert_same(first, again)


@pytest.mark.parametrize("spec", PEERS)
def test_ties_and_constant_rows(spec):
    for seed in range(3):
        bank = noisy_bank(np.random.default_rng(seed), 3, 30, 40)
        trace = run(spec, bank)
        assert np.isfinite(trace.confidence).all()
    blank = ScoreBank(
        np.ones((3, 30, 7)),
        ["T0", "T1", "T2"],
        [1, 2, 3],
        tolerance=1,
        name="blank",
        ground_truth=np.arange(30) % 7,
    )
    trace = run(spec, blank)
    assert np.isfinite(trace.confidence).all()
    if not spec.startswith(("hmm", "xu")):  # which know that the robot moves on
        assert (trace.predictions == 0).all()


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 30, 1), (2, 3, 2), (3, 30, 4)])
@pytest.mark.parametrize("spec", [*PEERS, "cascade:1/1/0.5"])
def test_short_routes_small_maps_few_techniques(spec, shape):
    scores = np.random.default_rng(3).normal(size=shape)
    truth = np.zeros(shape[1], np.int64)
    bank = ScoreBank(
        scores,
        [f"T{t}" for t in range(shape[0])],
        np.ones(shape[0]),
        tolerance=9,
        ground_truth=truth,
        name="small",
    )
    trace = run(spec, bank)
    assert (trace.predictions < shape[2]).all()
    assert np.isfinite(trace.confidence).all()


@pytest.mark.parametrize("spec", [*(spec for spec in PEERS), "cascade:1/5/margin=1"])
def test_along_a_live_route_as_on_its_bank(spec):
    bank, live = pair(40, 25)
    one = rollout(make(spec, bank), bank, name=spec)
    two = rollout(make(spec, live), live, name=spec)
    np.testing.assert_array_equal(one.predictions, two.predictions)
    np.testing.assert_array_equal(one.confidence, two.confidence)
    np.testing.assert_array_equal(one.ran, two.ran)


@pytest.mark.parametrize("spec", [spec for spec in PEERS if not spec.startswith("dynmpf")])
def test_any_scale_and_offset_of_a_techniques_scores_is_the_same(spec, four):
    scores = four.scores.astype(np.float64) * np.array([4.0, 0.5, 1.0, 32.0])[:, None, None]
    scores += np.array([1.0, -64.0, 0.0, 2.0])[:, None, None]
    other = ScoreBank(
        scores,
        four.techniques,
        four.seconds,
        tolerance=2,
        name="other",
        ground_truth=np.arange(scores.shape[1]),
    )
    one, two = run(spec, four), run(spec, other)
    np.testing.assert_array_equal(one.predictions, two.predictions)
    np.testing.assert_allclose(one.confidence, two.confidence, atol=1e-9)


@pytest.mark.parametrize(
    ("spec", "sentence"),
    [
        ("mpf:", "mpf:: R is ''; give a whole number from 0 to 1000000"),
        ("mpf:-1", "mpf:-1: R is '-1'; give a whole number"),
        ("mpf:2.5", "R is '2.5'; give a whole number"),
        ("mpf:²", "R is '²'; give a whole number"),
        ("mpf:" + "9" * 5000, "give a whole number from 0 to 1000000"),
        ("hmpf:3", "policy 'hmpf' takes no argument, got '3'; write hmpf"),
        ("dynmpf:far", "dynmpf:far: R is 'far'; give a whole number from 0 to 1000000"),
        ("switchhit:1.5", r"switchhit:1.5: TAU is '1.5'; give a number in \[0, 1\]"),
        ("switchhit:", r"TAU is ''; give a number in \[0, 1\]"),
        ("switchhit:nan", r"TAU is 'nan'; give a number in \[0, 1\]"),
        ("plurality:2", "policy 'plurality' takes no argument, got '2'; write plurality"),
        ("borda:0", "borda:0: DEPTH is '0'; give a whole number from 1 to 1000000"),
        ("hmm:0.5", "hmm:0.5 is not of the form hmm:BETA/JUMP; write it so"),
        ("hmm:-1/0.1", r"hmm:-1/0.1: BETA is '-1'; give a number in \[0, 100\]"),
        ("hmm:0.5/0", r"JUMP is '0'; give a number in \[1e-09, 1\]"),
        ("hmm:0.5/1.5", r"JUMP is '1.5'; give a number in \[1e-09, 1\]"),
        ("hmm:x/0.1", "BETA is 'x'; give a number"),
        ("xu:3", "xu:3 is not of the form xu:BACK/AHEAD/DELTA; write it so"),
        ("xu:T9/0/2/5", "unknown technique 'T9'"),
        ("xu:T0+T0/0/2/5", "xu:T0\\+T0/0/2/5 names a technique twice"),
        ("xu:T0/-1/2/5", "BACK is '-1'; give a whole number from 0"),
        ("xu:0/2/0.5", r"DELTA is '0.5'; give a number in \[1, 1e\+09\]"),
        ("lazygraph:5/0.7", "lazygraph:5/0.7 is not of the form lazygraph:FANOUT/RATE/NONMATCH"),
        ("lazygraph:0/0.7/6", "FANOUT is '0'; give a whole number from 1"),
        ("lazygraph:5/1.7/6", r"RATE is '1.7'; give a number in \[0, 1\]"),
        ("cascade:3", "cascade:3 is not of the form cascade:CHEAP/HOLD/THRESHOLD; write it so"),
        ("cascade:", "cascade: is not of the form cascade:CHEAP/HOLD/THRESHOLD"),
        ("cascade:0/5/0.5", "CHEAP is '0'; give a whole number from 1 to 4"),
        ("cascade:5/5/0.5", "cascade:5/5/0.5: CHEAP is '5'; give a whole number from 1 to 4"),
        ("cascade:1/0/0.5", "HOLD is '0'; give a whole number from 1 to 1000000"),
        ("cascade:1/5/1.5", r"THRESHOLD is '1.5'; give a number in \[0, 1\]"),
        ("cascade:1/5/p=2", r"THRESHOLD is '2'; give a number in \[0, 1\]"),
        ("cascade:1/5/margin=-2", "THRESHOLD is '-2'; give a number >= 0"),
        ("cascade:1/5/margin=inf", "THRESHOLD is 'inf'; give a number >= 0"),
        ("cascade:1/5/margni=2", "unknown kind of doubt 'margni': did you mean 'margin'"),
        ("cascade:1/5/=2", "unknown kind of doubt '': valid: p, margin"),
    ],
)
def test_arguments_are_refused(spec, sentence, four):
    with pytest.raises(ValueError, match=sentence):
        make(spec, four)


def test_policies_that_need_ground_truth_are_marked():
    needs = {name: one.needs_truth for name, one in POLICIES.items() if one.needs_truth}
    assert needs == {"oracle": "of the route itself", "switchhit": "of routes to learn from"}
    assert parse("switchhit:0.5").label == "SwitchHit-style † (0.5)"
    assert parse("oracle").label == "oracle †"
    assert parse("mpf:10").label == "MPF (10)"
    assert parse("ppo:switchhit").label == "selector (ppo:switchhit)"


# ---- what they share -----------------------------------------------------------------------------


def test_standardised_is_the_z_score_of_sic(four):
    rows = four.scores[:, 3].astype(np.float64)
    for row, z in zip(rows, standardised(rows), strict=True):
        np.testing.assert_allclose(z, loops.standardise(row.tolist()), atol=1e-12)
    tenths = np.full((2, 7), 0.1)
    assert tenths.std() > 0  # by rounding
    assert (standardised(tenths) == 0).all()
    assert (scaled(tenths) == 0).all()
    np.testing.assert_array_equal(scaled(np.array([[2.0, 4.0, 3.0]])), [[0.0, 1.0, 0.5]])


# ---- Multi-Process Fusion ------------------------------------------------------------------------


def test_the_ratio_is_to_the_best_place_outside():
    values = -np.array([5.0, 1.0, 3.0, 9.0, 8.0])
    assert ratio(values, 1, 0) == 1.0 / 3.0
    assert ratio(values, 1, 1) == 1.0 / 8.0
    assert ratio(values, 4, 2) == 8.0
    assert ratio(values, 2, 2) == 0.0
    assert ratio(values, 0, 10**6) == 0.0


def test_observations_are_floored():
    rows = np.array([[0.0, 5.0, 5.01, 10.0], [3.0, 3.0, 3.0, 3.0]])
    expected = [[0.001, 0.001, 0.5, 0.999], [0.001] * 4]  # .5 - .001 is below one half
    np.testing.assert_allclose(observations(rows), expected, atol=1e-12)


def dissenter_by_loops(seen, radius):
    best = [max(range(len(row)), key=lambda p, row=row: (row[p], -p)) for row in seen]
    t = range(len(seen))
    score = [sum(abs(best[i] - best[j]) <= radius for j in t if j != i) for i in t]
    if all(s == 0 for s in score) or all(s == len(seen) - 1 for s in score):
        return None
    leader = score.index(max(score))
    return min((j for j in t if j != leader), key=lambda j: (seen[j][best[leader]], j))


def test_the_technique_left_out_is_the_one_of_the_loops():
    rng = np.random.default_rng(1)
    found = set()
    for _ in range(300):
        techniques = int(rng.integers(1, 6))
        seen = observations(rng.integers(0, 9, (techniques, 12)).astype(np.float64))
        radius = int(rng.integers(0, 5))
        assert dissenter(seen, radius) == dissenter_by_loops(seen.tolist(), radius)
        found.add(dissenter(seen, radius))
    assert found == {None, 0, 1, 2, 3, 4}
    two = np.eye(2)
    assert dissenter(two, 0) is None  # nobody agrees
    assert dissenter(two, 1) is None  # all agree


@pytest.mark.parametrize("references", [1, 3, 8])
def test_viterbi_is_the_best_of_all_paths(references):
    rng = np.random.default_rng(references)
    jumped = 0
    for _ in range(12):
        emissions = np.log(rng.choice([1e-6, 0.04, 0.8], (4, references), p=[0.7, 0.1, 0.2]))
        emissions -= rng.random((4, references)) / 100  # no two paths are equally good
        paths = {}
        for path in product(range(references), repeat=4):
            total = emissions[0, path[0]]
            for q in range(1, 4):
                expected = 0 <= path[q] - path[q - 1] <= 5
                total += emissions[q, path[q]] + (0.0 if expected else math.log(0.001))
            paths[path] = total
        values, path = viterbi(emissions)
        best = max(paths, key=paths.get)
        assert tuple(path.tolist()) == best
        for place in range(references):
            most = max(total for path, total in paths.items() if path[-1] == place)
            assert values[-1, place] == pytest.approx(most)
        jumped += any(b < a or b > a + 5 for a, b in zip(best, best[1:], strict=False))
    assert (jumped > 0) == (references > 1)


def test_a_sequence_begins_where_the_ratio_falls_most():
    calm = [0.5] * 20
    assert sequence_start(calm) == 0
    assert sequence_start([]) == sequence_start([0.9]) == 0
    fallen = [0.5] * 8 + [0.4 - 1e-9] * 12
    assert sequence_start(fallen) == 8
    assert sequence_start([0.5] * 8 + [0.41] * 12) == 0  # not far enough
    assert sequence_start([0.5] * 8 + [0.9] * 12) == 0  # a rise is none
    assert sequence_start([0.9] * 4 + [0.7] * 4 + [0.2] * 12) == 8  # the greatest fall
    assert sequence_start([0.9] * 4 + [0.65] * 4 + [0.4] * 12) == 4  # of equal ones the first
    assert sequence_start([0.9] * 15 + [0.2] * 5) == 15
    assert sequence_start([0.9] * 16 + [0.2] * 4) == 0  # fewer than five frames would be left
    assert sequence_start([0.9, 0.2, 0.2, 0.2, 0.2]) == 0
    assert sequence_start([0.9, 0.2, 0.2, 0.2, 0.2, 0.2]) == 1


def mpf_by_loops(bank, radius):
    """The whole of MPF with a dense transition matrix."""
    places = np.arange(bank.references)
    move = places - places[:, None]  # from, to
    transition = np.where((move >= 0) & (move <= 5), 0.0, math.log(0.001))

    def ratio_at(column, place):
        far = [v for p, v in enumerate(column) if abs(p - place) > radius]
        return column[place] / max(far) if far else 0.0

    emissions, ratios, answers = [], [], []
    for q in range(bank.queries):
        seen = []
        for t in range(len(bank.techniques)):
            row = bank.row(t, q).astype(np.float64)
            o = (row - row.min()) / (row.max() - row.min()) - 0.001
            seen.append([v if v >= 0.5 else 0.001 for v in o])
        out = dissenter_by_loops(seen, radius)
        kept = [[math.log(v) for v in row] for t, row in enumerate(seen) if t != out]
        emissions.append(np.sum(kept, axis=0))
        ratios.append(ratio_at(emissions[-1], int(emissions[-1].argmax())))
        window = emissions[-20:]
        start = sequence_start(ratios[-20:])
        window = window[start:]
        columns, backward = [window[0]], []
        for emission in window[1:]:
            arrivals = columns[-1][:, None] + transition
            backward.append(arrivals.argmax(axis=0))
            columns.append(arrivals.max(axis=0) + emission)
        place = int(columns[-1].argmax())
        path = [place]
        for back in reversed(backward):
            path.append(int(back[path[-1]]))
        quality = [ratio_at(c, p) for c, p in zip(columns, reversed(path), strict=True)]
        answers.append((place, 1.0 - sum(quality) / len(quality), start))
    return zip(*answers, strict=True)


@pytest.mark.parametrize("radius", [3, 20])
def test_mpf_is_the_loops(radius, four):
    places, confidence = localise(MultiProcessFusion(radius), four)
    expected, sure, starts = mpf_by_loops(four, radius)
    assert places == expected
    np.testing.assert_allclose(confidence, sure, rtol=1e-9)
    assert len(set(starts)) > 1  # sequences were cut


def test_mpf_forgets_what_is_older_than_twenty_frames(four):
    cut = ScoreBank(
        four.scores[:, 10:],
        four.techniques,
        four.seconds,
        tolerance=2,
        ground_truth=np.arange(four.queries - 10),
    )
    late = run("mpf", cut)
    whole = run("mpf", four)
    assert (whole.confidence[10:29] != late.confidence[:19]).any()
    np.testing.assert_array_equal(whole.confidence[29:], late.confidence[19:])
    np.testing.assert_array_equal(whole.predictions[29:], late.predictions[19:])


# ---- hierarchical MPF ----------------------------------------------------------------------------


def test_tiers_are_by_cost():
    def tiers(*seconds):
        return [tier.tolist() for tier in tiers_by_cost(np.array(seconds, np.float64))]

    assert tiers(2.0, 0.5, 3.0, 1.0) == [[1, 3], [0], [2]]
    assert tiers(1.0, 1.0, 1.0) == [[0], [1], [2]]
    assert tiers(5.0, 1.0) == [[1], [0]]
    assert tiers(5.0) == [[0]]
    assert tiers(*range(8, 0, -1)) == [[7, 6, 5], [4, 3, 2], [1, 0]]


def hmpf_by_loops(rows, tiers):
    """Lists, one place at a time."""

    def unit(values):
        low, high = min(values.values()), max(values.values())
        return {p: (v - low) / (high - low) if high > low else 0.0 for p, v in values.items()}

    everywhere = candidates = list(range(len(rows[0])))
    levels = []
    for n, tier in enumerate(tiers):
        each = [unit({p: float(rows[t][p]) for p in candidates}) for t in tier]
        fuse_them = (lambda v: sum(v) / len(v)) if n == len(tiers) - 1 else max
        levels.append({p: fuse_them([e.get(p, 0.0) for e in each]) for p in everywhere})
        if n < len(tiers) - 1:
            ranked = [sorted(candidates, key=lambda p, e=e: (-e[p], p)) for e in each]
            candidates = sorted({p for r in ranked for p in r[: (100, 10)[n]]})
    total = dict.fromkeys(candidates, 0.0)
    for weight, level in zip((0.5, 0.75, 1.0), levels, strict=False):
        for p, v in unit({p: level[p] for p in candidates}).items():
            total[p] += weight * v
    z = dict(zip(total, loops.standardise(list(total.values())), strict=True))
    winner = max(candidates, key=lambda p: (z[p], -p))
    return winner, z[winner]


@pytest.mark.parametrize("techniques", [1, 2, 4, 7])
def test_hmpf_is_the_loops(techniques):
    bank = random_bank(3, techniques=techniques, queries=25, references=130, levels=10**5)
    rows = bank.scores.astype(np.float64)
    tiers = tiers_by_cost(np.random.default_rng(techniques).random(techniques))
    lists = [tier.tolist() for tier in tiers]
    for q in range(bank.queries):
        place, confidence = fuse(rows[:, q], tiers)
        expected, z = hmpf_by_loops(rows[:, q].tolist(), lists)
        assert place == expected
        assert confidence == pytest.approx(z)


def test_a_place_that_the_first_tier_drops_is_out():
    rows = np.zeros((3, 300))
    rows[0, :150] = np.linspace(1.0, 2.0, 150)  # passes 50 ... 149
    rows[1, 299] = rows[2, 299] = 9.0
    rows[1, 100] = rows[2, 100] = 1.0
    place, confidence = fuse(rows, [np.array([0]), np.array([1]), np.array([2])])
    assert place == 100
    assert confidence == pytest.approx(math.sqrt(9), rel=0.01)  # one among ten stands out


# ---- Dyn-MPF, votes ------------------------------------------------------------------------------


def test_subsets_are_all_of_them_the_smaller_first():
    table = subsets(3).astype(int).tolist()
    assert table == [
        [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1],
    ]  # fmt: skip


@pytest.mark.parametrize("radius", [2, 20])
def test_dynmpf_is_the_loops(radius, four):
    places, confidence = localise(DynamicFusion(radius), four)
    sizes = set()
    for q in range(four.queries):
        rows = [scaled(four.row(t, q).astype(np.float64)).tolist() for t in range(4)]
        best = (-1.0, 0)
        for size in range(1, 5):
            for names in combinations(range(4), size):
                fused = [sum(rows[t][p] for t in names) for p in range(four.references)]
                peak = fused.index(max(fused))
                next_peak = max(v for p, v in enumerate(fused) if abs(p - peak) > radius)
                ratio = max(fused) / next_peak
                if ratio > best[0] * (1 + 1e-12):
                    best, chosen = (ratio, peak), size
        sizes.add(chosen)
        assert places[q] == best[1]
        assert confidence[q] == pytest.approx(1 - 1 / best[0])
    assert len(sizes) > 1


def test_dynmpf_refuses_more_subsets_than_it_can_try():
    bank = random_bank(1, techniques=11, queries=2, references=5)
    with pytest.raises(ValueError, match="too many of 11 techniques; give a bank of at most 10"):
        make("dynmpf", bank)


def test_plurality_counts_votes_within_the_tolerance():
    rows = np.zeros((4, 20))
    for t, place in enumerate([3, 12, 5, 14]):
        rows[t, place] = 1.0
    z = math.sqrt(19)  # of one among 20
    both = 0.5 + z / (1 + z) / 4
    assert count_votes(rows, 1) == (3, pytest.approx(0.25 + z / (1 + z) / 4))
    assert count_votes(rows, 2) == (3, pytest.approx(both))
    assert count_votes(rows[[1, 0, 3, 2]], 2) == (12, pytest.approx(both))
    rows[1, 15] = 0.5  # the two voters of 12 and 14 are less sure
    assert count_votes(rows[[1, 0, 3, 2]], 2)[0] == 3
    rows[0, 16] = 1.1  # three votes beat one surer one
    assert count_votes(rows, 4)[0] in (12, 14, 16)
    rows[:2] = 7.0  # constant rows do not vote, least of all for place 0
    assert count_votes(rows, 2)[0] == 5
    assert count_votes(rows, 2)[1] < 0.5


def test_borda_points_are_shared_by_equal_scores():
    row = np.array([1.0, 5.0, 3.0, 3.0, 0.0])
    assert points(row, 5).tolist() == [0.4, 1.0, 0.7, 0.7, pytest.approx(0.2)]
    assert points(row, 99).tolist() == points(row, 5).tolist()
    assert points(row, 2).tolist() == [0.0, 1.0, 0.25, 0.25, 0.0]
    assert points(row, 1).tolist() == [0.0, 1.0, 0.0, 0.0, 0.0]
    assert len(set(points(np.full(9, 2.0), 3))) == 1


@pytest.mark.parametrize("depth", [5, 20, 70])
def test_borda_is_the_loops(depth, four):
    places, confidence = localise(Borda(depth), four)
    for q in range(four.queries):
        total = [0.0] * four.references
        for t in range(4):
            row = four.row(t, q).tolist()
            for p, own in enumerate(row):
                rank = sum(v > own for v in row) + (row.count(own) - 1) / 2
                total[p] += max(0.0, 1 - rank / depth) / 4
        best = max(total)
        assert confidence[q] == pytest.approx(best)
        assert total[places[q]] == pytest.approx(best)


# ---- hidden-Markov filter ------------------------------------------------------------------------


def transition(references, jump):
    """(R, R) from, to."""
    matrix = np.full((references, references), jump / references)
    for start in range(references):
        for step, chance in enumerate(MOVES):
            inside = start + step < references
            ends = start + step if inside else slice(None)
            matrix[start, ends] += (1 - jump) * chance / (1 if inside else references)
    return matrix


@pytest.mark.parametrize("references", [1, 2, 3, 9])
@pytest.mark.parametrize("jump", [0.01, 1.0])
def test_a_frame_on_is_the_dense_matrix(references, jump):
    matrix = transition(references, jump)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0)
    belief = np.random.default_rng(0).dirichlet(np.ones(references))
    np.testing.assert_allclose(advance(belief, jump), belief @ matrix, atol=1e-15)


@pytest.mark.parametrize(("beta", "jump"), [(0.2, 0.03), (1.0, 0.001)])
def test_hmm_is_the_dense_forward_algorithm(beta, jump, four):
    places, confidence = localise(MarkovFilter(beta, jump), four)
    matrix = transition(four.references, jump)
    belief = np.full(four.references, 1 / four.references)
    for q in range(four.queries):
        likelihood = np.ones(four.references)
        for t in range(4):
            likelihood *= np.exp(beta * np.array(loops.standardise(four.row(t, q).tolist())))
        belief = (belief if q == 0 else belief @ matrix) * likelihood
        belief /= belief.sum()
        assert places[q] == belief.argmax()
        near = [mass for p, mass in enumerate(belief) if abs(p - places[q]) <= 2]
        assert confidence[q] == pytest.approx(sum(near), abs=1e-9)


def test_hmm_survives_overwhelming_evidence_against_its_belief():
    scores = np.zeros((3, 40, 50))
    scores[:, np.arange(40), np.arange(40) // 20 * 49] = 1.0
    bank = ScoreBank(
        scores, ["T0", "T1", "T2"], [1, 1, 1], tolerance=1, ground_truth=np.arange(scores.shape[1])
    )
    places, confidence = localise(MarkovFilter(100.0, 1e-9), bank)
    assert places == (0,) * 20 + (49,) * 20
    assert np.isfinite(confidence).all()


# ---- SwitchHit -----------------------------------------------------------------------------------


def experience():
    """Three techniques: P(right) rises from 0 to 1 between z = 1 and 3, the third's from .5."""
    return Experience(
        score=np.array([1.0, 3.0]),
        p_right=np.array([[0.0, 1.0], [0.0, 1.0], [0.5, 1.0]]),
        helps=np.array([[0.0, 0.2, 0.7], [0.9, 0.0, 0.1], [0.3, 0.4, 0.0]]),
    )


def peaked(place, z, references=101):
    """A row whose best place has about that z-score: the others are alike but for two."""
    row = np.zeros(references)
    low, high = 0.0, 1e3
    for _ in range(80):
        middle = (low + high) / 2
        row[:] = 0.0
        row[::2], row[1::2] = 1.0, -1.0
        row[place] = middle
        low, high = (middle, high) if standardised(row)[place] < z else (low, middle)
    return row.astype(np.float32)


@pytest.mark.parametrize(
    ("sure", "first", "asked", "place", "p"),
    [
        ((2.9, 0, 0), 0, [0], 10, 0.95),  # sure enough at once
        ((2.0, 0, 2.9), 0, [0, 2], 30, 0.975),  # 2 helps most where 0 is wrong
        ((2.0, 2.9, 1.5), 0, [0, 2, 1], 20, 0.95),
        ((2.0, 2.4, 1.5), 0, [0, 2, 1], 20, 0.7),  # none is: the likeliest
        ((2.0, 1.2, 1.5), 0, [0, 2, 1], 30, 0.625),
        ((2.9, 1.5, 0), 1, [1, 0], 10, 0.95),  # begins elsewhere
        ((1.5, 1.5, 2.0), 2, [2, 1, 0], 30, 0.75),
    ],
)
def test_switchhit_goes_on_until_one_is_probably_right(sure, first, asked, place, p):
    rows = [peaked(10 * (t + 1), max(z, 1.1)) for t, z in enumerate(sure)]
    ran = []
    policy = SwitchHit(experience(), first, threshold=0.9)
    policy.reset(101, 3)
    found, confidence = policy.locate(0, lambda t: (ran.append(t), rows[t])[1])
    assert ran == asked
    assert found == place
    assert confidence == pytest.approx(p, abs=1e-3)


def test_switchhit_stops_at_the_threshold_itself():
    rows = [peaked(10, 2.0), peaked(20, 2.0), peaked(30, 2.0)]
    ran = []
    p = experience().correctness(0, float(standardised(rows[0].astype(np.float64))[10]))
    SwitchHit(experience(), 0, threshold=p).locate(0, lambda t: (ran.append(t), rows[t])[1])
    assert ran == [0]


def test_a_higher_threshold_runs_more(four):
    computes = [summarise(run(f"switchhit:{tau}", four))["compute"] for tau in (0, 0.3, 0.6, 1)]
    assert computes == sorted(computes)
    assert computes[0] == pytest.approx(0.5 / 6.5)  # the cheapest alone
    assert computes[-1] == pytest.approx(1.0)
    assert len(set(computes)) == 4


def test_experience_is_bayes_rule_on_densities_of_labelled_routes():
    banks = [random_bank(s, queries=60, references=80, levels=200) for s in (1, 2)]
    learned = Experience.of(banks)
    best = np.zeros((3, 120))
    right = np.zeros((3, 120), np.bool_)
    for b, bank in enumerate(banks):
        for t in range(3):
            for q in range(60):
                z = np.array(loops.standardise(bank.row(t, q).tolist()))
                best[t, 60 * b + q] = z.max()
                right[t, 60 * b + q] = abs(int(z.argmax()) - q) <= 2
    assert right.any(axis=1).all()
    assert not right.all(axis=1).any()
    for i in range(3):
        wrong = ~right[i]
        for j in range(3):
            share = (wrong & right[j]).sum() / wrong.sum()
            assert learned.helps[i, j] == pytest.approx(share)
    at = float(learned.score[60])
    for t in range(3):
        masses = []
        for kind in (right[t], ~right[t]):
            sample = best[t, kind]
            width = max(0.05, 1.06 * sample.std() * sample.size ** (-1 / 5))
            masses.append(sum(math.exp(-(((at - s) / width) ** 2) / 2) for s in sample) / width)
        assert learned.correctness(t, at) == pytest.approx(masses[0] / sum(masses))
    pooled = Experience.of(banks, pooled=True)
    assert (pooled.p_right == pooled.p_right[0]).all()
    assert (learned.p_right[0] != learned.p_right[1]).any()
    np.testing.assert_array_equal(pooled.helps, learned.helps)


def test_techniques_that_are_always_right_or_always_wrong():
    scores = np.zeros((2, 12, 30))
    scores[0, np.arange(12), np.arange(12)] = 1.0 + np.arange(12)
    scores[1, :, 29] = 1.0
    bank = ScoreBank(
        scores, ["good", "bad"], [1, 1], tolerance=0, ground_truth=np.arange(scores.shape[1])
    )
    learned = Experience.of([bank])
    assert (learned.p_right[0] == 1).all()
    assert (learned.p_right[1] == 0).all()
    assert learned.helps.tolist() == [[0.0, 0.0], [1.0, 0.0]]
    policy = SwitchHit(learned, first=1)
    places, confidence = localise(policy, bank)
    assert places == tuple(range(12))
    assert set(confidence) == {1.0}


def test_what_switchhit_cannot_learn_from_is_refused(four):
    with pytest.raises(ValueError, match="with the same techniques, got no route at all; give"):
        Experience.of([])
    other = random_bank(1)
    with pytest.raises(ValueError, match="got T0, T1, T2, T3 and T0, T1, T2; give some"):
        Experience.of([four, other])
    with pytest.raises(ValueError, match="has learned of 3 techniques, the route has 4; let it"):
        rollout(SwitchHit(experience(), 0), four, name="s")
    many = random_bank(1, techniques=27, queries=2, references=5)
    with pytest.raises(ValueError, match="at most 26 techniques, not 27; give a bank with fewer"):
        make("switchhit", many)


def test_simulated_experience_makes_sense():
    learned = simulated(4)
    assert learned.p_right.shape == (4, learned.score.size)
    low, high = learned.correctness(0, 2.0), learned.correctness(0, 5.0)
    assert low < 0.4 < 0.7 < high
    assert ((learned.helps >= 0) & (learned.helps <= 1)).all()
    assert np.diag(learned.helps).tolist() == [0.0] * 4


def test_order_of_the_techniques_does_not_matter_to_switchhit(four):
    order = [2, 0, 3, 1]
    other = four.subset([four.techniques[t] for t in order])
    one, two = run("switchhit:0.6", four), run("switchhit:0.6", other)
    np.testing.assert_array_equal(one.predictions, two.predictions)
    np.testing.assert_array_equal(one.ran[:, order], two.ran)
    assert len(np.unique(one.ran, axis=0)) > 2


def test_switchhit_knows_a_technique_by_its_rank_in_cost(four):
    policy = make("switchhit", four)
    rank = [sorted(four.seconds).index(s) for s in four.seconds]
    assert rank == [2, 0, 3, 1]
    assert policy.first == 1
    for i, j in product(range(4), repeat=2):
        assert policy.experience.helps[i, j] == simulated(4).helps[rank[i], rank[j]]


# ---- cascade with an argument --------------------------------------------------------------------


def test_cascade_by_argument(four):
    default, same = run("cascade", four), run("cascade:2/20/0.5", four)
    assert_same(default, same)
    assert_same(run("cascade:1/3/0.7", four), run("cascade:1/3/p=0.7", four))
    trace = run("cascade:1/3/0.7", four)
    low = np.flatnonzero(trace.p_correct[:-1] < 0.7)
    for frame in range(1, four.queries):
        doubted = any(frame - 3 <= q < frame for q in low)
        assert trace.ran[frame].tolist() == ([True] * 4 if doubted else [False, True, False, False])
    assert 0 < trace.ran[:, 0].sum() < four.queries


def test_cascade_doubts_a_small_margin():
    cascade = make("cascade:1/2/margin=1.5", random_bank(1))
    assert isinstance(cascade, Cascade)
    cascade.reset(np.array([True]))
    runs = []
    for frame, margin in enumerate([0.0, 1.6, 1.4, 1.6, 1.5, 1.6], -1):
        info = {
            "frame": np.array([frame]),
            "margin": np.array([margin]),
            "p_correct": np.array([0.0]),
            "present": np.ones((1, 3), np.bool_),
            "run_seconds": np.array([[1.0, 2.0, 3.0]]),
        }
        runs.append(int(cascade.act(None, info).sum()))
    assert runs == [1, 1, 3, 3, 1, 1]
