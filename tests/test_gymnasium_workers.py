"""Gymnasium's vector environments of this one, in processes or not, and what wrappers keep."""

from __future__ import annotations

import itertools
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from env_cases import ENV_NAME, assert_same, random_actions, random_bank
from gymnasium import spaces, wrappers
from gymnasium.error import ResetNeeded
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector

from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

BANK = random_bank(1, queries=9)
LENGTH, ROUTES = BANK.queries, 2
OPTIONS = {"compute_weight": (0.1, 3.0), "episode_length": 5, "random_start": True}
MODES = list(AutoresetMode)

single = partial(TechniqueSelectionEnv, BANK, **OPTIONS)


def native(mode: AutoresetMode = AutoresetMode.NEXT_STEP, **arguments):
    options = {**OPTIONS, **arguments}
    return TechniqueSelectionVectorEnv(ROUTES, BANK, autoreset_mode=mode, **options)


@pytest.fixture
def workers():
    """Makes environments in processes, which end with the test."""
    made = []

    def make(mode: AutoresetMode = AutoresetMode.NEXT_STEP, **options) -> AsyncVectorEnv:
        made.append(AsyncVectorEnv([single] * ROUTES, autoreset_mode=mode, **options))
        return made[-1]

    yield make
    for env in made:
        env.close()


# ---- in processes --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "options"), [(m, {}) for m in MODES] + [(MODES[0], {"shared_memory": False})]
)
def test_in_processes_the_steps_are_those_of_the_native_one(workers, mode, options):
    envs = [workers(mode, **options), native(mode)]
    assert envs[0].observation_space == envs[1].observation_space
    assert envs[0].action_space == envs[1].action_space
    assert envs[0].metadata["autoreset_mode"] is envs[1].metadata["autoreset_mode"] is mode
    assert_same(*(env.reset(seed=[4, 7]) for env in envs))
    ended = 0
    for action in random_actions(1, 14, (ROUTES, 3)):
        first, second = (env.step(action) for env in envs)
        assert_same(first, second)
        over = second[2] | second[3]
        ended += over.any()
        if mode is AutoresetMode.DISABLED and over.any():
            assert_same(*(env.reset(options={"reset_mask": over}) for env in envs))
    assert ended >= 2
    assert_same(*(env.reset() for env in envs))  # goes on with the generators of the routes


def test_in_processes_attributes_and_calls_are_the_environments_own(workers):
    envs = [workers(), native()]
    for env in envs:
        env.reset(seed=3)
    for name in ("np_random_seed", "render_mode", "observation_space", "action_space"):
        assert envs[0].get_attr(name) == envs[1].get_attr(name)
    assert envs[0].call("render") == envs[1].call("render")
    for env in envs:
        env.set_attr("mark", 5)
        assert env.get_attr("mark") == (5,) * ROUTES
    envs[0].set_attr("mark", [1, 2])  # processes share nothing
    assert envs[0].get_attr("mark") == (1, 2)


@pytest.mark.filterwarnings("ignore:.*ERROR:UserWarning")  # Gymnasium tells of it, too
def test_a_refused_action_in_a_process_is_the_error_of_the_environment(workers):
    env = workers()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action value 2"):
        env.step(np.full((ROUTES, 3), 2, np.int8))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", ["sync", "vector_entry_point"])
def test_make_vec_makes_each_kind_alike(kind, mode):
    how = {"bank": BANK, "compute_weight": 0.5, "max_episode_steps": 4}
    if kind == "sync":
        env = gym.make_vec(
            ENV_NAME, ROUTES, vectorization_mode=kind, vector_kwargs={"autoreset_mode": mode}, **how
        )
        assert isinstance(env.unwrapped, SyncVectorEnv)
    else:
        env = gym.make_vec(ENV_NAME, ROUTES, vectorization_mode=kind, autoreset_mode=mode, **how)
    bare = native(mode, compute_weight=0.5, episode_length=4, random_start=False)
    assert_same(env.reset(seed=1)[0], bare.reset(seed=1)[0])
    for action in random_actions(2, 4, (ROUTES, 3)):
        first, second = env.step(action), bare.step(action)
        assert_same(first[:4], second[:4])
    assert second[3].all()
    assert not second[2].any()


# ---- what wrappers keep --------------------------------------------------------------------


def episodes(env, actions, seed: int):
    """Rewards of whole episodes, each with the info of its last step."""
    found, rewards = [], []
    env.reset(seed=seed)
    for action in actions:
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        if terminated or truncated:
            found.append((rewards, info, truncated))
            rewards = []
            env.reset()
    return found


def test_statistics_of_episodes_are_sums_of_their_rewards():
    env = wrappers.RecordEpisodeStatistics(single(), buffer_length=3)
    found = episodes(env, random_actions(4, 30, (3,)), seed=2)
    assert len(found) > 4
    for rewards, info, _ in found:
        assert info["episode"]["r"] == pytest.approx(sum(rewards), rel=1e-6)
        assert info["episode"]["l"] == len(rewards)
    assert list(env.length_queue) == [len(rewards) for rewards, *_ in found[-3:]]
    assert env.episode_count == len(found)


@pytest.mark.parametrize("mode", MODES[:2])
def test_statistics_of_a_vector_are_those_of_every_route(mode):
    env = vector.RecordEpisodeStatistics(native(mode))
    env.reset(seed=5)
    sums, lengths, begun = np.zeros(ROUTES), np.zeros(ROUTES, int), np.zeros(ROUTES, bool)
    ended = 0
    for action in random_actions(3, 24, (ROUTES, 3)):
        _, reward, terminated, truncated, info = env.step(action)
        sums, lengths = np.where(begun, 0.0, sums + reward), np.where(begun, 0, lengths + 1)
        over = terminated | truncated
        for i in np.flatnonzero(over):
            ended += 1
            assert info["episode"]["r"][i] == pytest.approx(sums[i], rel=1e-6)
            assert info["episode"]["l"][i] == lengths[i]
        if mode is AutoresetMode.SAME_STEP:
            sums[over], lengths[over] = 0.0, 0
        else:
            begun = over  # the next step begins anew, whatever the action
    assert ended > 6
    assert env.episode_count == ended


def test_a_time_limit_truncates_and_the_last_frame_terminates():
    whole = partial(TechniqueSelectionEnv, BANK)
    cut = wrappers.TimeLimit(whole(), 4)
    for rewards, _, truncated in episodes(cut, random_actions(1, 20, (3,)), seed=0):
        assert (len(rewards), truncated) == (4, True)
    both = wrappers.TimeLimit(whole(), LENGTH)
    both.reset(seed=0)
    ends = [both.step(action)[2:4] for action in random_actions(1, LENGTH, (3,))]
    assert ends[-1] == (True, True)  # TimeLimit says both; the environment itself: terminated
    made = gym.make(ENV_NAME, bank=BANK, max_episode_steps=3)
    assert made.spec.max_episode_steps == 3
    made.reset(seed=0)
    assert [made.step([1, 0, 0])[2:4] for _ in range(3)][-1] == (False, True)


def test_steps_out_of_order_are_refused_through_wrappers():
    env = gym.make(ENV_NAME, bank=BANK)
    assert isinstance(env, wrappers.OrderEnforcing)
    with pytest.raises(ResetNeeded):
        env.step([1, 0, 0])
    env.reset()
    for _ in range(LENGTH):
        env.step([1, 0, 0])
    with pytest.raises(ResetNeeded, match="after every end"):
        env.step([1, 0, 0])
    assert env.has_reset


def test_normalised_rewards_are_the_same_single_and_vector():
    alone = TechniqueSelectionVectorEnv(1, BANK, compute_weight=0.5, autoreset_mode="SameStep")
    envs = [
        vector.NormalizeReward(alone),
        wrappers.NormalizeReward(TechniqueSelectionEnv(BANK, compute_weight=0.5)),
    ]
    for env in envs:
        env.reset(seed=3)
    for action in random_actions(6, LENGTH, (3,)):
        first, second = envs[0].step(action[None])[1], envs[1].step(action)[1]
        assert first[0] == pytest.approx(second, rel=1e-6)
    assert envs[0].return_rms.var == pytest.approx(envs[1].return_rms.var, rel=1e-6)


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_wrappers_in_any_order_are_the_same_single_and_vector(order):
    single_layers = [
        partial(wrappers.ClipReward, min_reward=0.0, max_reward=0.2),
        wrappers.FlattenObservation,
        partial(
            wrappers.TransformObservation,
            func=lambda seen: seen * np.float32(0.5),
            observation_space=spaces.Box(-1, 1, single().observation_space.shape, np.float32),
        ),
    ]
    vector_layers = [
        partial(vector.ClipReward, min_reward=0.0, max_reward=0.2),
        vector.FlattenObservation,
        partial(vector.TransformObservation, func=lambda seen: seen * np.float32(0.5)),
    ]

    def wrapped():
        env = single()
        for number in order:
            env = single_layers[number](env)
        return env

    own, env = SyncVectorEnv([wrapped] * ROUTES), native()
    for number in order:
        env = vector_layers[number](env)
    assert_same(own.reset(seed=2), env.reset(seed=2))
    for action in random_actions(5, 8, (ROUTES, 3)):
        assert_same(own.step(action), env.step(action))
