"""What the environment does with misuse and odd input: one test per row of the promises."""

from __future__ import annotations

import inspect
from functools import partial

import gymnasium as gym
import numpy as np
import oracle
import pytest
from amusic_baselines import make_policy
from env_cases import (
    ENV_NAME,
    assert_same,
    infos_of,
    make,
    noisy_bank,
    play,
    random_actions,
)
from gymnasium.error import ResetNeeded

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.settings import STATISTICS
from amusic_gym.estimation.sic.correction import SIC
from amusic_gym.policies.protocol import Context

# ---- 6 -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["single", "wrapped", "vector"])
def test_06_step_before_reset_is_refused(kind, bank):
    env = make(kind, bank)
    with pytest.raises(ResetNeeded, match=r"reset"):
        env.step(np.ones(env.action_space.shape, np.int8))


@pytest.mark.parametrize("arguments", [{}, {"episode_length": 3}])
def test_06_step_after_the_end_is_refused(arguments, bank):
    env = TechniqueSelectionEnv(bank, **arguments)
    env.reset(options={"start": 36})
    ended = False
    while not ended:
        _, _, terminated, truncated, _ = env.step([1, 0, 0])
        ended = terminated or truncated
    for _ in range(2):
        with pytest.raises(ResetNeeded, match=r"call reset\(\) first, and after every end"):
            env.step([1, 0, 0])
    env.reset()
    env.step([1, 0, 0])


def test_06_step_after_an_end_without_autoreset_is_refused(bank):
    env = TechniqueSelectionVectorEnv(2, bank, autoreset_mode="Disabled")
    env.reset(options={"start": np.array([0, 39])})
    env.step(np.ones((2, 3)))
    with pytest.raises(ResetNeeded, match=r"routes \[1\] have ended; .*reset_mask"):
        env.step(np.ones((2, 3)))


# ---- 7 -----------------------------------------------------------------------------------

WRONG_VALUES = [2, -1, 0.7, np.nan, np.inf, 255]
WRONG_SHAPES = [1, [1, 0], [1, 0, 1, 0], [[1, 0, 1]], []]


@pytest.mark.parametrize("value", WRONG_VALUES)
def test_07_wrong_action_values_are_refused(value, bank):
    single, vector = TechniqueSelectionEnv(bank), TechniqueSelectionVectorEnv(2, bank)
    for env, action in ((single, [1, value, 0]), (vector, [[1, 0, 0], [0, 0, value]])):
        env.reset(seed=0)
        with pytest.raises(ValueError, match=r"action value .*; MultiBinary\(3\) takes 0 and 1"):
            env.step(np.array(action))


@pytest.mark.parametrize("action", WRONG_SHAPES)
def test_07_wrong_action_shapes_are_refused(action, bank):
    single, vector = TechniqueSelectionEnv(bank), TechniqueSelectionVectorEnv(2, bank)
    for env in (single, vector):
        env.reset(seed=0)
        with pytest.raises(ValueError, match=r"action of shape .*; the action space has \("):
            env.step(np.array(action))


def test_07_a_refused_action_changes_nothing(bank):
    env, plain = TechniqueSelectionEnv(bank), TechniqueSelectionEnv(bank)
    for e in (env, plain):
        e.reset(seed=0)
    with pytest.raises(ValueError, match="action"):
        env.step([1, 0, 2])
    assert_same(env.step([1, 0, 1]), plain.step([1, 0, 1]))


@pytest.mark.parametrize(
    "kind", [bool, np.int8, np.uint8, np.int64, np.float32, np.float64, np.longdouble]
)
def test_07_any_dtype_of_zeros_and_ones_is_fine(kind, bank):
    for env, action in (
        (TechniqueSelectionEnv(bank), [1, 0, 1]),
        (TechniqueSelectionVectorEnv(2, bank), [[1, 0, 1], [0, 1, 1]]),
    ):
        env.reset(seed=0)
        ran = env.step(np.array(action, dtype=kind))[4]["ran"]
        assert ran.tolist() == np.array(action, bool).tolist()


# ---- 8 -----------------------------------------------------------------------------------


def test_08_all_zero_action_runs_the_cheapest_and_says_so(bank):
    info = infos_of(TechniqueSelectionEnv(bank), [[0, 0, 0]])[0]
    assert info["ran"].tolist() == [True, False, False]  # the bank's cheapest is its first
    assert info["fallback"]
    assert not info["idle"]
    reselecting = TechniqueSelectionEnv(bank, reselection=4)
    assert infos_of(reselecting, [[0, 0, 0, 1]])[0]["fallback"]  # nothing to select from yet


def test_08_all_zero_action_runs_nothing_where_allowed(bank):
    info = infos_of(TechniqueSelectionEnv(bank, allow_idle=True), [[0, 0, 0]])[0]
    assert not info["ran"].any()
    assert info["idle"]
    assert not info["fallback"]
    assert info["prediction"] == -1
    assert info["seconds"] == 0.0


@pytest.mark.parametrize("behind", [1, 3, 6])
def test_08_reselect_with_few_frames_behind_is_over_those(behind, bank):
    env = TechniqueSelectionEnv(bank, reselection=6, statistic="mean")
    infos = infos_of(env, [[1, 0, 0, 0]] * behind + [[0, 0, 0, 1]])
    assert not any(info["selection"]["happened"] for info in infos[:-1])
    selection = infos[-1]["selection"]
    exists = [[True, False, False] for _ in range(behind)]
    settings = (50, 1000, 1.0, "mean", oracle.standardise_bank(bank.scores))
    expected = oracle.select(bank.scores, exists, list(range(behind)), settings, 0.7)
    assert selection["happened"]
    assert selection["tally"].tolist() == expected.tally
    assert selection["late_runs"].tolist() == expected.late_runs == [0, behind, behind]
    assert np.flatnonzero(selection["selected"]).tolist() == expected.chosen


# ---- 9 -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["single", "wrapped", "vector"])
def test_09_whole_seeds_are_accepted(kind):
    env = make(kind)
    actions = random_actions(0, 12, env.action_space.shape)
    expected = play(env, actions, seed=3)
    for seed in (np.int64(3), np.uint8(3), np.int32(3)):
        assert_same(expected, play(env, actions, seed=seed))
    env.reset(seed=0)
    env.reset(seed=2**32 + 1)
    env.reset(seed=None)


@pytest.mark.parametrize("kind", ["single", "wrapped", "vector"])
@pytest.mark.parametrize("seed", [-1, 1.5, np.int64(-1), np.float64(2.0), "1"])
def test_09_other_seeds_are_refused(kind, seed, bank):
    with pytest.raises(ValueError, match=r"seed is .*; give a whole number >= 0"):
        make(kind, bank).reset(seed=seed)


def test_09_seeds_of_routes_are_checked_too(bank):
    env = make("vector", bank)
    first = env.reset(seed=[np.int64(4), 5, np.uint8(6)])
    assert_same(first, env.reset(seed=4))
    for wrong in ([1, 2], [1, -2, 3], [1, 2.5, 3], [1, 2, 3, 4]):
        with pytest.raises(ValueError, match="seed"):
            env.reset(seed=wrong)


# ---- 10 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["single", "wrapped", "vector"])
def test_10_close_twice_is_fine(kind, bank):
    env = make(kind, bank)
    env.reset(seed=0)
    env.close()
    env.close()
    make(kind, bank).close()


@pytest.mark.parametrize("number", [0, -1])
def test_10_zero_envs_are_refused(number, bank):
    words = f"num_envs is {number}; give a whole number >= 1"
    with pytest.raises(ValueError, match=words):
        TechniqueSelectionVectorEnv(number, bank)
    with pytest.raises(ValueError, match=words):
        gym.make_vec(ENV_NAME, num_envs=number, bank=bank)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"statistic": "evidnce"}, "'evidnce': did you mean 'evidence'. valid: mean, evidence"),
        (
            {"render_mode": "xyz"},
            "unknown render mode 'xyz': valid: ansi, rgb_array, rgb_array_list, human",
        ),
        ({"render_mode": "ANSI"}, "unknown render mode 'ANSI': did you mean 'ansi'"),
        ({"costs": "paprika"}, "'paprika': did you mean 'paper'. valid: measured, paper, runs"),
        ({"reward": "truth"}, "'truth': .*valid: estimated, ground_truth"),
        ({"reselection": 0}, "reselection is 0; give a whole number >= 1, or None"),
        ({"reselection": 2.5}, "reselection is 2.5"),
        ({"coverage": 0.0}, r"coverage \(E\) is 0.0; give a number in \(0, 1\]"),
        ({"coverage": 1.1}, r"coverage \(E\) is 1.1"),
        ({"episode_length": 0}, "episode_length is 0; give a whole number >= 1, or None"),
        ({"slots": 0}, "slots is 0; give a whole number >= 3, or None"),
    ],
)
def test_10_unknown_arguments_are_refused_with_the_valid_ones(wrong, words, bank):
    for way in (TechniqueSelectionEnv, partial(TechniqueSelectionVectorEnv, 2)):
        with pytest.raises(ValueError, match=words):
            way(bank, **wrong)


def test_10_an_argument_of_another_name_is_refused_in_python_s_words(bank):
    words = "unexpected keyword argument 'statistik': .*did you mean 'statistic'.*candidates"
    for way in (TechniqueSelectionEnv, partial(TechniqueSelectionVectorEnv, 2)):
        with pytest.raises(TypeError, match=words):
            way(bank, statistik="mean")


def test_the_signatures_of_both_environments_name_the_same_arguments():
    single, several = (
        dict(inspect.signature(kind).parameters)
        for kind in (TechniqueSelectionEnv, TechniqueSelectionVectorEnv)
    )
    for own in ("num_envs", "autoreset_mode", "max_episode_steps"):
        del several[own]
    assert single == several
    assert {"statistic", "compute_weight", "render_mode"} < set(single)


def test_10_unknown_options_modes_techniques_and_policies_are_refused(bank):
    with pytest.raises(ValueError, match=r"'strat': did you mean 'start'\? valid: bank, start"):
        TechniqueSelectionEnv(bank).reset(options={"strat": 3})
    with pytest.raises(ValueError, match=r"did you mean 'SameStep'\? valid: NextStep"):
        TechniqueSelectionVectorEnv(2, bank, autoreset_mode="SameStp")
    context = Context.of(bank, statistic="mean")
    with pytest.raises(ValueError, match="unknown technique 'T7': .*valid: T0, T1, T2"):
        make_policy("single:T7", context)
    with pytest.raises(ValueError, match=r"'amusik': did you mean 'amusic'\? valid: raw, single"):
        make_policy("amusik", context)


@pytest.mark.parametrize(
    "options",
    [
        {"start": 1.5},
        {"start": "one"},
        {"bank": "one"},
        {"bank": 0.5},
        {"compute_weight": "much"},
        {"compute_weight": float("nan")},
    ],
)
def test_10_options_of_the_wrong_kind_are_refused(options, bank):
    for env in (TechniqueSelectionEnv(bank), TechniqueSelectionVectorEnv(2, bank)):
        with pytest.raises(ValueError, match=f"{next(iter(options))}.*give"):
            env.reset(options=options)


# ---- 12 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 7), (3, 9, 1), (2, 6, 4)])
@pytest.mark.parametrize("statistic", STATISTICS)
def test_12_one_query_one_reference_fewer_than_candidates(shape, statistic):
    bank = noisy_bank(np.random.default_rng(0), *shape)
    env = TechniqueSelectionEnv(bank, statistic=statistic, candidates=50, reselection=3)
    actions = random_actions(0, shape[1], (shape[0] + 1,), reselect=0.4)
    env.reset(seed=0)
    for frame, action in enumerate(actions):
        observation, _, terminated, _, info = env.step(action)
        assert env.observation_space.contains(observation)
        assert 0 <= info["prediction"] < shape[2]
        assert terminated == (frame == shape[1] - 1)


@pytest.mark.parametrize("shape", [(2, 0, 5), (2, 5, 0), (0, 5, 5)])
def test_12_zero_of_either_is_refused(shape):
    with pytest.raises(ValueError, match="scores|techniques|queries|references"):
        ScoreBank(np.zeros(shape), ["A", "B"][: shape[0]], np.ones(shape[0]), tolerance=1)
    with pytest.raises(ValueError, match="a map has at least one place"):
        SIC(0)


# ---- 13 ----------------------------------------------------------------------------------


CONSTANT = [0.0, 0.1, -3e7, 1e-30, 3e38]


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
@pytest.mark.parametrize("value", CONSTANT)
def test_13_constant_rows_are_zeros(value, statistic):
    scores = np.full((2, 6, 9), value)
    bank = ScoreBank(
        scores, ["A", "B"], [1.0, 1.0], tolerance=1, ground_truth=np.arange(scores.shape[1])
    )
    for info in infos_of(TechniqueSelectionEnv(bank, statistic=statistic), np.ones((6, 2))):
        assert info["confidence"] == 0.0
        assert info["prediction"] == 0
        assert not info["statistic"].any()
        assert not info["correction"].any()


@pytest.mark.parametrize("value", CONSTANT)
def test_13_constant_rows_say_nothing_of_the_place(value, bank):
    """The belief is the same whether such a technique runs or not."""
    scores = np.array(bank.scores)
    scores[1] = value
    flat = ScoreBank(
        scores, bank.techniques, bank.seconds, tolerance=2, ground_truth=np.arange(scores.shape[1])
    )
    env = TechniqueSelectionEnv(flat, statistic="belief", allow_idle=True)
    rest = random_actions(0, 40, (3,))
    for actions in (np.zeros((40, 3), np.int8), rest):
        actions[0, 0] = 1  # there is a prediction from the first frame on
        actions[:, 1] = 0
        without = infos_of(env, actions)
        for info, expected in zip(infos_of(env, actions + [0, 1, 0]), without, strict=True):
            assert info["prediction"] == expected["prediction"]
            assert info["margin"] == pytest.approx(expected["margin"], abs=1e-9)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("late", [False, True])
def test_13_scores_that_are_not_finite_are_refused(value, late, bank, tmp_path):
    scores = np.array(bank.scores)
    scores[1, 7, 3] = value
    with pytest.raises(ValueError, match=r"'?T1'? .*7"):
        ScoreBank(
            scores,
            bank.techniques,
            bank.seconds,
            tolerance=2,
            ground_truth=np.arange(scores.shape[1]),
        )
    path = bank.save(tmp_path / "bank")
    stored = np.load(path / "scores.npy", mmap_mode="r+")
    stored[1, 7, 3] = value
    stored.flush()
    del stored
    env = TechniqueSelectionEnv(path, reselection=6)
    env.reset(options={"start": 2})
    for _ in range(5):
        env.step([1, 0, 1, 0])
    env.step([1, not late, 1, 0]) if late else None
    with pytest.raises(ValueError, match="technique 'T1' at frame 7; mend the scores"):
        env.step([1, 0, 1, 1] if late else [0, 1, 0, 0])


# ---- 14 ----------------------------------------------------------------------------------


def test_14_ties_go_to_the_lowest_index():
    scores = np.zeros((3, 8, 20), np.float32)
    scores[:, :, [4, 9, 15]] = 1.0  # three equal places in every row of every technique
    bank = ScoreBank(
        scores, ["A", "B", "C"], np.ones(3), tolerance=0, ground_truth=np.arange(scores.shape[1])
    )
    for statistic in STATISTICS:
        chosen = {"statistic": statistic, "history": 0, "reselection": 4, "coverage": 0.2}
        infos = infos_of(TechniqueSelectionEnv(bank, **chosen), [[1, 1, 1, 0]] * 7 + [[0, 0, 0, 1]])
        # the belief tells equal places apart as soon as it knows where one may have come from
        tied = infos[:1] if statistic == "belief" else infos
        assert {info["prediction"] for info in tied} == {4}
        assert {info["technique"] for info in infos} == {0}
        assert infos[-1]["selection"]["tally"].tolist() == [4, 0, 0]
        assert infos[-1]["ran"].tolist() == [True, False, False]
        assert {info["place"].tolist()[2] for info in tied[:7]} == {4}
        assert infos_of(TechniqueSelectionEnv(bank), [[0, 0, 0]])[0]["ran"].tolist() == [1, 0, 0]
    sic = SIC(20)
    assert sic.correct(scores[0, 0]).place == 4


def test_14_equal_tallies_take_the_lower_technique():
    scores = np.zeros((3, 2, 9), np.float32)
    scores[2, 0, 0] = scores[1, 1, 0] = 1.0  # frame 0 is C's, frame 1 is B's
    bank = ScoreBank(scores, ["A", "B", "C"], np.ones(3), tolerance=0, ground_truth=[0, 0])
    three = ScoreBank(
        np.concatenate([scores, scores[:, :1]], axis=1),
        ["A", "B", "C"],
        np.ones(3),
        tolerance=0,
        ground_truth=[0, 0, 0],
    )
    env = TechniqueSelectionEnv(three, reselection=2, coverage=0.5, history=0)
    selection = infos_of(env, [[1, 1, 1, 0]] * 2 + [[0, 0, 0, 1]])[-1]["selection"]
    assert selection["tally"].tolist() == [0, 1, 1]
    assert selection["selected"].tolist() == [False, True, False]
    assert bank.queries == 2
