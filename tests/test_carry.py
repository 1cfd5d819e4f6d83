"""Carried candidates and the discount for serial correlation: by hand, and in any kind of drive."""

from __future__ import annotations

import copy
import math
import pickle
from functools import cache

import numpy as np
import pytest
from env_cases import assert_same, infos_of, noisy_bank, play, random_actions, random_bank
from hypothesis import given, settings
from hypothesis import strategies as st
from live_cases import NAMES, Stream, bank_of, live_of, maps_of, pair, traverse
from selection_cases import assert_details, assert_route, follow

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs import live_rows, memory
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.prediction import IDLE_DECAY
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic import state as kernels
from amusic_gym.estimation.sic.correction import SIC

pytestmark = pytest.mark.slow

TWINS = [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]

cached_pair = cache(pair)
ours = st.fixed_dictionaries(
    {
        "statistic": st.sampled_from(["evidence", "mean"]),
        "carry": st.booleans(),
        "discount": st.booleans(),
        "history": st.sampled_from([0, 1, 3, 1000]),
        "gamma": st.sampled_from([1.0, 0.9]),
        "candidates": st.sampled_from([1, 4, 50]),
        "reselection": st.sampled_from([None, 1, 3, 7]),
        "allow_idle": st.booleans(),
    }
)


def bank_from(*rows, places=None, **options) -> ScoreBank:
    """A bank of one technique per (Q, R) array of scores."""
    scores = np.array(rows, np.float32)
    names = [f"T{t}" for t in range(len(scores))]
    truth = np.full(scores.shape[1], -1) if places is None else places
    options = {"tolerance": 0, **options}
    return ScoreBank(scores, names, np.ones(len(scores)), ground_truth=truth, **options)


def actions_for(arguments, rng, steps: int, width: int):
    """Random bits, sparse or dense, and a rare re-select bit where there is one."""
    actions = rng.random((steps, width + (arguments["reselection"] is not None)))
    actions = actions < rng.choice([0.1, 0.5, 0.9])
    if arguments["reselection"]:
        actions[:, -1] = rng.random(steps) < 0.15
    return actions


# ---- worked out by hand ------------------------------------------------------------------


def test_by_itself_the_evidence_carries_and_discounts_and_the_mean_does_not():
    for statistic, on in [("evidence", True), ("mean", False), ("belief", False)]:
        chosen = SICSettings(statistic)
        assert (chosen.carry, chosen.discount) == (on, on)
    for name in ("carry", "discount"):
        with pytest.raises(ValueError, match=f"{name} is True, but 'belief' has no candidates"):
            SICSettings("belief", **{name: True})
        assert not getattr(SICSettings("belief", **{name: False}), name)


# Rows of six places whose z-scores are those numbers over σ; K is 1.
FAR = [[5, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 2], [0, 0, 1, 0, 2, 0]]


def test_the_own_last_match_is_a_candidate_and_the_correction_is_from_the_rows_best():
    sic, plain = (SIC(6, SICSettings(candidates=1, carry=carry)) for carry in (True, False))
    assert [plain.correct(row).place for row in FAR] == [0, 5, 4]
    found = [sic.correct(row) for row in FAR]
    assert [match.place for match in found] == [0, 1, 2]
    z = [(np.array(row) - np.mean(row)) / np.std(row) for row in FAR]
    own, best = (z[0][0] + z[1][1]) / math.sqrt(2), (z[0][4] + z[1][5]) / math.sqrt(2)
    assert found[1].statistic == pytest.approx(own)
    assert found[1].correction == pytest.approx(own - best)


@pytest.mark.parametrize(("fused", "place"), [(-1, 1), (2, 2), (5, 1), (6, 1)])
def test_the_last_prediction_is_a_candidate(fused, place):
    sic = SIC(6, SICSettings(candidates=1))
    sic.correct([5, 5, 0, 0, 0, 0])  # places 0 and 1
    assert sic.correct([0, 1, 2, 0, 3, 0], fused=fused).place == place


def test_of_equal_ones_the_rows_best_is_first_then_the_own_match_then_the_last_prediction():
    first, second = [0, 0, 3, 0, 0, 0], [0, 0, 0, 1, 0, 1]
    settings = SICSettings(candidates=1, history=0)
    sic = SIC(6, settings)
    assert sic.correct(first).place == 2
    assert sic.correct(second, fused=5).place == 3  # of the row
    sic = SIC(6, SICSettings(candidates=1))
    assert sic.correct([3, 0, 3, 0, 0, 0]).place == 0
    # Places 1 and 3 have the same past, the same score, and more than place 5, the row's best.
    assert sic.correct([0, 5, 0, 5, 0, 6], fused=3).place == 1
    sic = SIC(6, SICSettings(candidates=1))
    sic.correct([3, 0, 3, 0, 0, 0])
    assert sic.correct([0, 5, 0, 5.1, 0, 6], fused=3).place == 3


def test_what_left_the_map_is_not_kept_at_its_end():
    sic = SIC(6, SICSettings(candidates=1))
    assert sic.correct([0, 0, 0, 0, 8, 9]).place == 5
    # Place 5 would be better than 0, with its past.
    assert sic.correct([5, 0, 0, 0, 0, 4.5], fused=6).place == 0
    sic = SIC(6, SICSettings(candidates=1))
    sic.correct([0, 0, 0, 0, 8, 9])
    assert sic.correct([5, 0, 0, 0, 0, 4.5], fused=5).place == 5


def test_in_the_environment_the_own_match_is_before_the_last_prediction():
    sure, torn = [[0, 0, 9, 0, 0, 0], [0] * 6], [[3, 0, 3, 0, 0, 0], [0, 5, 0, 5, 0, 6]]
    env = TechniqueSelectionEnv(bank_from(sure, torn), candidates=1, reselection=1)
    infos = infos_of(env, [[1, 1, 0], [0, 1, 0]])
    assert [info["prediction"] for info in infos] == [2, 1]
    assert [info["place"][1] for info in infos] == [0, 1]  # 3 is as good


def test_what_is_carried_beyond_the_map_is_dropped():
    sic = SIC(3, SICSettings(candidates=1))
    assert sic.correct([0, 0, 1]).place == 2
    assert sic.correct([1, 0, 0], fused=3).place == 0
    sic.skip()
    sic.skip()
    assert sic.correct([0, 1, 0], fused=9).place == 1  # 0 would be at 3


@pytest.mark.parametrize(("carry", "place"), [(True, 3), (False, 8)])
def test_both_are_moved_on_while_nothing_runs(carry, place):
    first, later = 9 * np.eye(9)[0], np.eye(9)[8] + 0.5 * np.eye(9)[3]
    bank = bank_from([first, later, later, later])
    env = TechniqueSelectionEnv(bank, candidates=1, allow_idle=True, carry=carry)
    infos = infos_of(env, [[1], [0], [0], [1]])
    assert [info["prediction"] for info in infos] == [0, 1, 2, place]


def test_a_technique_takes_up_the_last_prediction_of_another():
    sure = [9 * np.eye(9)[q] for q in range(3)]
    torn = [2 * np.eye(9)[q] + 2.1 * np.eye(9)[best] for q, best in enumerate([3, 6, 8])]
    env = TechniqueSelectionEnv(bank_from(sure, torn), candidates=1)
    infos = infos_of(env, [[1, 0], [1, 1], [0, 1]])
    assert [info["place"].tolist() for info in infos] == [[0, 0], [1, 6], [0, 2]]
    assert infos[2]["correction"][1] > 0.0


def test_selections_go_on_from_what_others_found_when_they_looked_back():
    """Blocks overlap or not, few candidates, sparse runs: much hangs on what is carried on."""
    for seed in range(25):
        rng = np.random.default_rng(seed)
        bank = random_bank(seed, queries=40, references=45)
        chosen = SICSettings(candidates=2, history=(1000, 6)[seed % 2])
        actions = rng.random((40, 4)) < (0.2, 0.5)[seed // 2 % 2]
        actions[:, -1] = rng.random(40) < 0.2
        env = TechniqueSelectionEnv(bank, **vars(chosen), reselection=4, allow_idle=True)
        infos = infos_of(env, actions)
        expected = follow(bank, actions, chosen, block=4, idle=True)
        assert_route(infos, expected, bank.seconds)
        assert_details(infos, expected, bank.tolerance, "evidence")


def test_the_discount_by_hand():
    rows = np.random.default_rng(2).normal(size=(4, 12)).astype(np.float32)
    rows[2:, 1:] = rows[1:3, :-1]  # moved on by one place
    sic, z = SIC(12), (rows - rows.mean(1, keepdims=True)) / rows.std(1, keepdims=True)
    assert sic.discount == pytest.approx(math.sqrt(0.5 / 1.5))
    total, weight = 5.0, 10.0
    for q, row in enumerate(rows):
        sic.correct(row)
        if q:
            total = 0.98 * total + float(np.mean(z[q - 1][:-1].astype(float) * z[q][1:]))
            weight = 0.98 * weight + 1.0
        rho = total / weight
        assert sic.discount == pytest.approx(math.sqrt((1 - rho) / (1 + rho)), rel=1e-5)
    sic.skip()
    before = sic.discount
    sic.correct(rows[0])  # not a neighbour of any row
    assert sic.discount == before
    sic.correct(rows[0])
    assert sic.discount != before


def test_standing_rows_that_move_along_the_map_leave_a_little():
    wave = np.sin(np.arange(5000) / 300.0)
    rows = np.array([wave[3000 - q : 4000 - q] for q in range(700)], np.float32)
    sic = SIC(1000)
    for row in rows:
        sic.correct(row)
    rho = min(0.999, float(np.corrcoef(rows[-2][:-1], rows[-1][1:])[0, 1]))
    assert sic.discount == pytest.approx(math.sqrt((1 - rho) / (1 + rho)), rel=0.1)
    assert sic.discount >= math.sqrt(0.001 / 1.999) - 1e-12


def test_rows_of_the_opposite_kind_are_not_worth_more_than_independent_ones():
    row = np.array([1, -1] * 20, np.float32)
    sic = SIC(40)
    for _ in range(200):
        sic.correct(row)
    assert sic.discount == 1.0


def test_music_chooses_by_the_discounted_statistic_but_tells_the_plain_one():
    rng = np.random.default_rng(0)
    wall = np.convolve(rng.normal(size=400), np.ones(12), "same")
    blurry = np.array([wall[100 - q : 300 - q] for q in range(50)])  # the same, moved on
    sharp = rng.normal(size=(50, 200))
    sharp[np.arange(50), 60 + np.arange(50)] += 1.5
    infos, plain = (
        infos_of(
            TechniqueSelectionEnv(bank_from(blurry, sharp), discount=discount),
            np.ones((50, 2)),
        )
        for discount in (True, False)
    )
    last = infos[-1]
    assert (plain[-1]["technique"], last["technique"]) == (0, 1)
    assert last["statistic"][0] > last["statistic"][1]
    assert last["confidence"] == last["statistic"][1]
    np.testing.assert_array_equal(last["statistic"], plain[-1]["statistic"])
    np.testing.assert_array_equal(last["correction"], plain[-1]["correction"])


def test_the_mean_is_the_papers_to_the_digit():
    bank = random_bank(5)
    actions = random_actions(5, bank.queries, (4,))
    explicit = {"carry": False, "discount": False}
    first, second = (
        TechniqueSelectionEnv(bank, statistic="mean", reselection=5, **more)
        for more in ({}, explicit)
    )
    assert_same(play(first, actions), play(second, actions))


# ---- a bank, a live route, a batch, a copy -----------------------------------------------


@settings(max_examples=80, deadline=None)
@given(ours, st.integers(0, 2**32 - 1), st.sampled_from([(90, 9), (70, 40), (8, 1)]), st.booleans())
def test_a_live_route_gives_what_its_bank_gives(arguments, seed, size, anywhere):
    bank, live = cached_pair(*size)
    arguments = {**arguments, "random_start": anywhere}
    actions = actions_for(arguments, np.random.default_rng(seed), 110, len(NAMES))
    wanted = play(TechniqueSelectionEnv(bank, **arguments), actions, seed)
    assert_same(play(TechniqueSelectionEnv(live, **arguments), actions, seed), wanted)


@pytest.mark.parametrize("room", [1, 2, 3])
def test_a_live_route_keeps_rows_for_as_long_as_they_are_needed(monkeypatch, room):
    monkeypatch.setattr(live_rows, "ROOM", room)
    bank, live = cached_pair(90, 9)
    rng = np.random.default_rng(room)
    for history in range(5):
        for block in (None, 1, 2, 5):
            arguments = {"history": history, "reselection": block, "candidates": 3}
            for _ in range(3):
                actions = actions_for(arguments, rng, 89, len(NAMES))
                wanted = play(TechniqueSelectionEnv(bank, **arguments), actions)
                assert_same(play(TechniqueSelectionEnv(live, **arguments), actions), wanted)


@pytest.mark.parametrize("history", [0, 5, 1000])
def test_a_live_route_whose_rows_wait_to_be_added_gives_what_its_bank_gives(monkeypatch, history):
    monkeypatch.setattr(kernels, "LARGE", 1)
    bank, live = cached_pair(90, 9)
    rng = np.random.default_rng(history)
    for block in (None, 2, 5):
        arguments = {"history": history, "reselection": block, "candidates": 3}
        for _ in range(3):
            actions = actions_for(arguments, rng, 89, len(NAMES))
            first, second = (TechniqueSelectionEnv(each, **arguments) for each in (live, bank))
            assert_same(play(first, actions), play(second, actions))
            assert first.task.episodes.estimator.state.marks["depth"].all()


def test_what_is_carried_outlives_the_growing_room_of_an_endless_route(monkeypatch):
    monkeypatch.setattr(memory, "ROOM", 4)
    maps, images = maps_of(40), traverse(60, seed=2)
    arguments = {"reselection": 3, "candidates": 2, "allow_idle": True}
    for seed in range(6):
        actions = np.random.default_rng(seed).random((59, 4)) < (0.3, 0.3, 0.3, 0.4)
        first = TechniqueSelectionEnv(live_of(maps, Stream(images)), **arguments)
        second = TechniqueSelectionEnv(bank_of(maps, images), **arguments)
        assert_same(play(first, actions), play(second, actions))


@settings(max_examples=40, deadline=None)
@given(ours, st.integers(0, 2**32 - 1))
def test_a_batch_gives_what_its_routes_give(arguments, seed):
    rng = np.random.default_rng(seed)
    banks = [
        random_bank(seed % 1000 + i, queries=q, references=r)
        for i, (q, r) in enumerate([(20, 30), (33, 40), (9, 9)])
    ]
    actions = np.stack([actions_for(arguments, rng, 40, 3) for _ in range(3)], axis=1)
    vector = TechniqueSelectionVectorEnv(3, banks, autoreset_mode="Disabled", **arguments)
    observations = [vector.reset(seed=0, options={"bank": np.arange(3)})[0]]
    for action in actions[:9]:
        observations.append(vector.step(action)[0])
    for i in range(3):
        env = TechniqueSelectionEnv(banks, **arguments)
        seen = [env.reset(seed=i, options={"bank": i})[0]]
        seen += [env.step(action[i])[0] for action in actions[:9]]
        assert np.array_equal(seen, [one[i] for one in observations])


@settings(max_examples=30, deadline=None)
@given(ours, st.integers(0, 2**32 - 1), st.integers(0, 29), st.sampled_from(TWINS))
def test_a_copy_goes_on_alike(arguments, seed, at, twin_of):
    bank = random_bank(seed % 1000, queries=30, references=30)
    actions = actions_for(arguments, np.random.default_rng(seed), 30, 3)
    env = TechniqueSelectionEnv(bank, **arguments)
    env.reset(seed=0)
    for action in actions[:at]:
        env.step(action)
    twin = twin_of(env)
    assert_same([twin.step(action) for action in actions[at:]], [env.step(a) for a in actions[at:]])


@settings(max_examples=60, deadline=None)
@given(ours, st.integers(0, 2**32 - 1), st.integers(2, 3), st.booleans())
def test_54_copies_of_techniques_change_neither_places_nor_p(arguments, seed, copies, constant):
    """Of p̂ it is true where no row is constant: such a row is not like its copy."""
    rng = np.random.default_rng(seed)
    references = int(rng.integers(1 if constant else 2, 30))
    one = noisy_bank(rng, 2, 25, references, levels=int(rng.integers(2, 9)))
    if not constant:
        scores = one.scores.copy()
        scores[..., 0] += scores.max(axis=2) == scores.min(axis=2)
        one = ScoreBank(scores, one.techniques, one.seconds, tolerance=1, ground_truth=one.truth)
    names = [f"{name} {k}" for k in range(copies) for name in one.techniques]
    scores, seconds = np.tile(one.scores, (copies, 1, 1)), np.tile(one.seconds, copies)
    many = ScoreBank(scores, names, seconds, tolerance=1, ground_truth=one.truth)
    actions = actions_for({**arguments, "reselection": None}, rng, 25, 2)
    actions[~actions.any(axis=1), int(np.argmin(one.seconds))] = True
    if arguments["reselection"]:
        selections = rng.random((25, 1)) < 0.1
        first = np.hstack([actions, selections])
        second = np.hstack([np.tile(actions, copies), selections])
    else:
        first, second = actions, np.tile(actions, copies)
    found, wanted = (
        infos_of(TechniqueSelectionEnv(bank, **arguments), bits)
        for bank, bits in ((many, second), (one, first))
    )
    for info, expected in zip(found, wanted, strict=True):
        if arguments["reselection"] and expected["selection"]["happened"]:
            tally = info["selection"]["tally"]
            assert tally.tolist() == [*expected["selection"]["tally"], *[0] * (2 * copies - 2)]
            break  # it runs one of each from here on
        for name in ("prediction", "confidence", "margin", "technique"):
            assert info[name] == expected[name]
        # The likeness of copies is 1 but for rounding.
        assert info["p_correct"] == pytest.approx(expected["p_correct"], rel=1e-9)


def test_a_copy_whose_row_is_constant_confirms_nothing():
    rows = np.random.default_rng(0).normal(size=(10, 30)) + 3.0 * np.eye(10, 30)
    rows[6] = 1.0
    alone, doubled = (
        infos_of(TechniqueSelectionEnv(bank_from(*[rows] * n)), np.ones((10, n))) for n in (1, 2)
    )
    found, wanted = ([info["p_correct"] for info in infos] for infos in (doubled, alone))
    np.testing.assert_allclose(found[:6], wanted[:6])
    np.testing.assert_allclose(found[7:], wanted[7:])
    np.testing.assert_allclose(found[6], wanted[6])


# ---- what is observed --------------------------------------------------------------------


def test_on_idle_frames_the_logit_is_that_of_what_is_left_of_p():
    bank = random_bank(3, queries=30, references=30)
    env = TechniqueSelectionEnv(bank, allow_idle=True)
    env.reset(seed=0)
    route = env.task.episodes.state.routes
    env.step([0, 0, 0])
    assert route["logit"][0] == 0.0  # nothing is known yet
    env.step([1, 1, 1])
    p = route["p_correct"][0]
    for k in range(1, 25):
        env.step([0, 0, 0])
        left = p * IDLE_DECAY**k
        assert route["p_correct"][0] == pytest.approx(left)
        assert route["logit"][0] == pytest.approx(math.log(left / (1.0 - left)))


@settings(max_examples=80, deadline=None)
@given(ours, st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 40))
def test_observations_are_finite_and_within_their_bounds(arguments, seed, references, queries):
    """On maps that end before the route, too, beyond which everything is carried."""
    rng = np.random.default_rng(seed)
    bank = noisy_bank(rng, 2, queries, references, levels=int(rng.integers(1, 5)))
    env = TechniqueSelectionEnv(bank, **arguments)
    env.reset(seed=0)
    for action in actions_for(arguments, rng, queries, 2):
        observation, reward, *_, info = env.step(action)
        assert np.isfinite(reward)
        assert (abs(observation) <= 1.0).all()  # false for NaN
        for name in ("place", "statistic", "correction", "confidence", "margin", "p_correct"):
            assert np.isfinite(info[name]).all()
        assert ((info["place"] >= 0) & (info["place"] < references)).all()
