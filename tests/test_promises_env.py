"""What the project promises of the environment: one test per row, its number in the name."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
from functools import partial
from itertools import combinations
from pathlib import Path

import gymnasium as gym
import numpy as np
import oracle
import pytest
from env_cases import (
    ENV_NAME,
    EVERYTHING,
    REGISTERED,
    arrays,
    assert_same,
    digest,
    infos_of,
    noisy_bank,
    play,
    random_actions,
    random_bank,
)
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from amusic_gym.bank import ScoreBank
from amusic_gym.env import TechniqueSelectionEnv
from amusic_gym.policy import Context
from amusic_gym.settings import STATISTICS
from amusic_gym.sic import SIC
from amusic_gym.vector_env import TechniqueSelectionVectorEnv
from baselines import make_policy

TESTS = Path(__file__).resolve().parent


def python(code: str, *arguments: object, stdin: bytes = b"") -> str:
    """What ``code`` prints in a process of its own, where warnings are errors."""
    path = os.pathsep.join([str(TESTS.parent), str(TESTS)])
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *map(str, arguments)],
        input=stdin,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "random"},
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode().strip()


def make(kind: str, bank=None, **arguments):
    """The environment in each way a user may hold it."""
    arguments = {**EVERYTHING, **arguments}
    if kind == "wrapped":
        return gym.make(ENV_NAME, bank=bank, **arguments)
    if kind == "vector":
        return TechniqueSelectionVectorEnv(3, bank, autoreset_mode="SameStep", **arguments)
    return TechniqueSelectionEnv(bank, **arguments)


# ---- 1 -----------------------------------------------------------------------------------

OTHER_PROCESS = """
from env_cases import digest, play, random_actions
from test_promises_env import make
env = make({kind!r})
print(digest(play(env, random_actions(3, 40, env.action_space.shape), seed=17)))
"""


@pytest.mark.parametrize("kind", ["single", "vector"])
def test_01_same_seed_same_trajectory_in_this_and_another_process(kind):
    env = make(kind)
    actions = random_actions(3, 40, env.action_space.shape)
    here = play(env, actions, seed=17)
    assert_same(here, play(env, actions, seed=17))
    assert_same(here, play(make(kind), actions, seed=17))
    assert digest(here) == python(OTHER_PROCESS.format(kind=kind))
    assert digest(here) != digest(play(env, actions, seed=18))


def test_01_same_seed_same_trajectory_single_and_vector():
    single, vector = make("single"), TechniqueSelectionVectorEnv(1, **EVERYTHING)
    actions = random_actions(3, 12, single.action_space.shape)
    alone, together = play(single, actions, seed=17), play(vector, actions[:, None], seed=17)
    for one, many in zip(alone[:13], together, strict=True):  # the single one was begun again
        assert_same(one[0], many[0][0])
        assert one[1:-1] == tuple(part[0] for part in many[1:-1])
        for key in ("prediction", "confidence", "p_correct", "technique", "seconds"):
            assert one[-1][key] == many[-1][key][0]


# ---- 2 -----------------------------------------------------------------------------------

COPIES = {"pickle": lambda env: pickle.loads(pickle.dumps(env)), "deepcopy": copy.deepcopy}

CONTINUE = """
import pickle, sys
from env_cases import digest
env, actions = pickle.loads(sys.stdin.buffer.read())
print(digest([env.step(action) for action in actions]))
"""


def halfway(env, seed=2, steps=8):
    """Play half an episode; the actions for the other half."""
    actions = random_actions(seed, 2 * steps, env.action_space.shape, reselect=0.3)
    env.reset(seed=seed)
    for action in actions[:steps]:
        env.step(action)
    return actions[steps:]


@pytest.fixture(params=["simulated", "memory", "disk"])
def any_bank(request, bank, tmp_path):
    if request.param == "disk":
        return ScoreBank.load(bank.save(tmp_path / "bank"))
    return bank if request.param == "memory" else None


@pytest.mark.parametrize("kind", ["single", "wrapped", "vector"])
@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("history", [3, 1000])  # rows leave a short one
def test_02_a_copy_in_mid_episode_continues_identically(kind, way, any_bank, history):
    env = make(kind, any_bank, episode_length=16, history=history)
    rest = halfway(env)
    twin = COPIES[way](env)
    second = COPIES[way](twin)
    expected = [env.step(action) for action in rest]
    assert_same(expected, [twin.step(action) for action in rest])
    after = [e.reset() for e in (env, twin)]  # the generators continue alike, too
    assert_same(*after)
    del env, twin
    assert_same(expected, [second.step(action) for action in rest])


@pytest.mark.parametrize("kind", ["single", "vector"])
def test_02_a_pickle_continues_identically_in_another_process(kind, any_bank):
    env = make(kind, any_bank, episode_length=16)
    rest = halfway(env)
    sent = pickle.dumps((env, rest))
    assert digest([env.step(action) for action in rest]) == python(CONTINUE, stdin=sent)


def test_02_a_copy_before_the_first_reset_works(bank):
    for way in COPIES.values():
        twin = way(TechniqueSelectionEnv(bank))
        assert_same(twin.reset(seed=1), TechniqueSelectionEnv(bank).reset(seed=1))


def test_02_a_pickle_of_a_bank_on_disk_holds_no_scores(tmp_path):
    bank = random_bank(1, techniques=4, queries=100, references=1000)
    env = TechniqueSelectionEnv(bank.save(tmp_path / "bank"))
    env.reset(seed=0)
    assert len(pickle.dumps(env)) < bank.scores.nbytes / 4


# ---- 3 -----------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", AutoresetMode)
def test_03_native_vector_is_the_sync_vector(mode, bank):
    arguments = {**EVERYTHING, "bank": [bank, random_bank(2)]}
    sync = SyncVectorEnv([partial(TechniqueSelectionEnv, **arguments)] * 3, autoreset_mode=mode)
    native = TechniqueSelectionVectorEnv(3, autoreset_mode=mode, **arguments)
    assert_same(sync.reset(seed=5), native.reset(seed=5))
    for action in random_actions(1, 60, native.action_space.shape):
        first, second = sync.step(action), native.step(action)
        assert_same(first, second)
        done = first[2] | first[3]
        if mode is AutoresetMode.DISABLED and done.any():
            both = [e.reset(options={"reset_mask": done.copy()}) for e in (sync, native)]
            assert_same(*both)


# ---- 4 -----------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [{}, {**EVERYTHING, "episode_length": 90}])
@pytest.mark.parametrize("name", REGISTERED)
def test_04_ten_thousand_random_steps_stay_inside_the_space(name, arguments):
    env = gym.make(f"amusic_gym:{name}", **arguments)
    env.action_space.seed(0)
    observation, info = env.reset(seed=0)
    for _ in range(10_000):
        assert env.observation_space.contains(observation)
        assert np.isfinite(observation).all()
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert np.isfinite(reward)
        assert 0.0 <= info["p_correct"] <= 1.0
        if terminated or truncated:
            assert env.observation_space.contains(observation)
            observation, info = env.reset()


@pytest.mark.parametrize("name", REGISTERED)
def test_04_checkers_pass_without_a_warning(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gym.make(f"amusic_gym:{name}").unwrapped
    check_env(env)
    checker.check_env(env)


# ---- 5 -----------------------------------------------------------------------------------


def spoil(value) -> None:
    """Overwrite every array and every entry of nested returns."""
    for array in arrays(value):
        array.fill(None if array.dtype == object else 77)
    for part in value if isinstance(value, tuple) else ():
        if isinstance(part, dict):
            for nested in [p for p in part.values() if isinstance(p, dict)]:
                nested.clear()
            part.clear()


@pytest.mark.parametrize("kind", ["single", "vector"])
def test_05_overwriting_what_was_returned_changes_nothing(kind, bank):
    env, spoiled = make(kind, bank), make(kind, bank)
    actions = random_actions(4, 40, env.action_space.shape)
    for action in [None, *actions]:
        given = None if action is None else action.copy()
        both = [
            e.reset(seed=1) if action is None else e.step(a)
            for e, a in ((env, action), (spoiled, given))
        ]
        assert_same(*both)
        spoil(both[1])
        if given is not None:
            given.fill(1)
        if kind == "single" and action is not None and (both[0][2] or both[0][3]):
            assert_same(env.reset(), spoiled.reset())


@pytest.mark.parametrize("kind", ["single", "vector"])
def test_05_no_two_returned_arrays_share_memory(kind, bank):
    env = make(kind, bank)
    returned = play(env, random_actions(4, 14, env.action_space.shape, reselect=0.4))
    found = [array for array in arrays(returned) if array.size]
    assert len(found) > 100
    assert len({id(array) for array in found}) == len(found)
    for first, second in combinations(found, 2):
        assert not np.may_share_memory(first, second)
    inside = [a for a in arrays(list(env.task.episodes.state)) if a.size]
    for first in found:
        assert not any(np.may_share_memory(first, own) for own in [*inside, bank.scores])


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
    words = f"num_envs is {number}; give at least 1"
    with pytest.raises(ValueError, match=words):
        TechniqueSelectionVectorEnv(number, bank)
    with pytest.raises(ValueError, match=words):
        gym.make_vec(ENV_NAME, num_envs=number, bank=bank)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"statistic": "evidnce"}, "'evidnce': did you mean 'evidence'. valid: mean, evidence"),
        ({"render_mode": "human"}, "unknown render mode 'human': valid: ansi"),
        ({"render_mode": "ANSI"}, "unknown render mode 'ANSI': did you mean 'ansi'"),
        ({"costs": "paprika"}, "'paprika': did you mean 'paper'. valid: measured, paper, runs"),
        ({"reward": "truth"}, "'truth': .*valid: estimated, ground_truth"),
        ({"reselection": 0}, "reselection is 0; give a whole number >= 1, or None"),
        ({"reselection": 2.5}, "reselection is 2.5"),
        ({"coverage": 0.0}, r"coverage \(E\) is 0.0; give a number in \(0, 1\]"),
        ({"coverage": 1.1}, r"coverage \(E\) is 1.1"),
        ({"episode_length": 0}, "episode_length is 0; give a whole number >= 1, or None"),
        ({"slots": 0}, "slots is 0; give a whole number >= 3, or None"),
        ({"statistik": "mean"}, "'statistik': did you mean 'statistic'. valid: .*candidates"),
    ],
)
def test_10_unknown_arguments_are_refused_with_the_valid_ones(wrong, words, bank):
    for way in (TechniqueSelectionEnv, partial(TechniqueSelectionVectorEnv, 2)):
        with pytest.raises(ValueError, match=words):
            way(bank, **wrong)


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


# ---- 11 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("context", ["spawn", "forkserver"])
def test_11_workers_find_it_by_name(context, bank, tmp_path):
    single = partial(gym.make, ENV_NAME, bank=str(bank.save(tmp_path / "bank")), reselection=4)
    workers = AsyncVectorEnv([single] * 2, context=context)
    native = TechniqueSelectionVectorEnv(2, bank, reselection=4)
    try:
        assert_same(workers.reset(seed=3)[0], native.reset(seed=3)[0])
        for action in random_actions(0, 8, (2, 4)):
            first, second = workers.step(action), native.step(action)
            assert_same(first[:4], second[:4])
    finally:
        workers.close()


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


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("value", [0.0, 0.1, -3e7, 1e-30, 3e38])
def test_13_constant_rows_are_zeros(value, statistic):
    scores = np.full((2, 6, 9), value)
    bank = ScoreBank(scores, ["A", "B"], [1.0, 1.0], tolerance=1)
    for info in infos_of(TechniqueSelectionEnv(bank, statistic=statistic), np.ones((6, 2))):
        assert info["confidence"] == 0.0
        assert info["prediction"] == 0
        assert not info["statistic"].any()
        assert not info["correction"].any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("late", [False, True])
def test_13_scores_that_are_not_finite_are_refused(value, late, bank, tmp_path):
    scores = np.array(bank.scores)
    scores[1, 7, 3] = value
    with pytest.raises(ValueError, match=r"'?T1'? .*7"):
        ScoreBank(scores, bank.techniques, bank.seconds, tolerance=2)
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
    bank = ScoreBank(scores, ["A", "B", "C"], np.ones(3), tolerance=0)
    for statistic in STATISTICS:
        chosen = {"statistic": statistic, "history": 0, "reselection": 4, "coverage": 0.2}
        infos = infos_of(TechniqueSelectionEnv(bank, **chosen), [[1, 1, 1, 0]] * 7 + [[0, 0, 0, 1]])
        assert {info["prediction"] for info in infos} == {4}
        assert {info["technique"] for info in infos} == {0}
        assert infos[-1]["selection"]["tally"].tolist() == [4, 0, 0]
        assert infos[-1]["ran"].tolist() == [True, False, False]
        assert {info["place"].tolist()[2] for info in infos[:-1]} == {4}
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


# ---- 40 ----------------------------------------------------------------------------------

QUIET = """
import gymnasium as gym
env = gym.make("amusic_gym:amusic_gym/TechniqueSelection-v0", reselection=5, render_mode="ansi")
env.reset(seed=0)
for action in ([1, 0, 0, 0, 0], [0, 0, 0, 0, 1], [1, 1, 1, 1, 0]):
    env.step(env.action_space.sample() * 0 + action)
    env.render()
env.close()
vector = gym.make_vec("amusic_gym:amusic_gym/TechniqueSelection-v0", num_envs=3)
vector.reset(seed=0)
vector.step(vector.action_space.sample())
vector.close()
"""


def test_40_a_process_where_warnings_are_errors_has_none():
    assert python(QUIET) == ""
