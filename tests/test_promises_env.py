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
import pytest
from env_cases import (
    ENV_NAME,
    EVERYTHING,
    REGISTERED,
    arrays,
    assert_same,
    digest,
    make,
    play,
    random_actions,
    random_bank,
)
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

ROOT = Path(__file__).resolve().parent.parent
PATHS = (ROOT, ROOT / "tests/support")
pytestmark = pytest.mark.slow


def python(code: str, *arguments: object, stdin: bytes = b"") -> str:
    """What ``code`` prints in a process of its own, where warnings are errors."""
    path = os.pathsep.join(map(str, PATHS))
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


# ---- 1 -----------------------------------------------------------------------------------

OTHER_PROCESS = """
from env_cases import digest, make, play, random_actions
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
    env = gym.make(f"amusic_gym:{name}").unwrapped
    check_env(env)
    check_env_sb3(env)


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
    inside = [
        a
        for a in arrays([vars(env.task.episodes.state), vars(env.task.episodes.estimator.state)])
        if a.size
    ]
    for first in found:
        assert not any(np.may_share_memory(first, own) for own in [*inside, bank.scores])


# ---- 11 ----------------------------------------------------------------------------------


forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("context", [pytest.param("fork", marks=forks), "spawn", "forkserver"])
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


FORKS = """
import os, sys, time, warnings
import cv2, numpy as np
import gymnasium as gym
warnings.filterwarnings("ignore", ".*fork.*", DeprecationWarning)
env = gym.make("amusic_gym:amusic_gym/TechniqueSelection-v0", bank=sys.argv[1],
               render_mode="rgb_array")
env.reset(seed=0)
cv2.setNumThreads(4)
for attempt in range(16):
    picture = env.render()
    cv2.resize(np.zeros((1500, 1500), np.uint8), (2000, 2000))  # wakes all threads
    child = os.fork()
    if not child:
        cv2.setNumThreads(1 + attempt % 2)
        os._exit(int((env.render() != picture).any()))
    for _ in range(1000):
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            break
        time.sleep(0.01)
    else:
        os.kill(child, 9)
        sys.exit("a forked child hangs")
    assert status == 0 and cv2.getNumThreads() == 4
"""


@forks
def test_11_a_forked_process_renders_after_its_parent_has_rendered(bank, tmp_path):
    python(FORKS, bank.save(tmp_path / "bank"))


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
