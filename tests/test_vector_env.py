"""The native vector environment is N single ones, bit for bit."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from env_cases import ENV_NAME, EVERYTHING, assert_same, play, random_actions, random_bank
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st

from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

MODES = list(AutoresetMode)


def pair(number: int, mode: AutoresetMode, **arguments):
    """Gymnasium's synchronous vector of single environments, and the native one."""
    single = partial(TechniqueSelectionEnv, **arguments)
    sync = SyncVectorEnv([single] * number, autoreset_mode=mode)
    return sync, TechniqueSelectionVectorEnv(number, autoreset_mode=mode, **arguments)


def assert_equal_runs(sync, native, actions, seed, options=None) -> int:
    """Play both side by side; how many episodes ended."""
    assert_same(*(env.reset(seed=seed, options=options) for env in (sync, native)), "reset")
    ends = 0
    for number, action in enumerate(actions):
        first, second = (env.step(action) for env in (sync, native))
        assert_same(first, second, f"step {number}")
        done = first[2] | first[3]
        ends += int(done.sum())
        if native.autoreset_mode is AutoresetMode.DISABLED and done.any():
            both = [env.reset(options={"reset_mask": done.copy()}) for env in (sync, native)]
            assert_same(*both, f"reset after step {number}")
    return ends


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("reselection", [None, 7])
@pytest.mark.parametrize("crops", [False, True])
def test_equals_the_single_ones(bank, mode, reselection, crops):
    arguments = {
        "bank": [bank, random_bank(2, queries=7, references=90), random_bank(3, queries=25)],
        "reselection": reselection,
        "episode_length": 12 if crops else None,
        "random_start": crops,
        "compute_weight": (0.1, 3.0),
        "allow_idle": crops,
    }
    sync, native = pair(4, mode, **arguments)
    actions = random_actions(1, 120, native.action_space.shape)
    assert assert_equal_runs(sync, native, actions, seed=5) >= 8


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(MODES),
    st.integers(1, 4),
    st.lists(st.tuples(st.integers(1, 6), st.integers(1, 12), st.integers(12, 20)), min_size=1),
    st.integers(0, 2**31),
    st.sampled_from([None, 1, 4]),
    st.booleans(),
    st.sampled_from([None, 1, 5]),
)
def test_equals_the_single_ones_on_any_banks(mode, number, sizes, seed, block, idle, length):
    banks = [random_bank(seed + i, *size) for i, size in enumerate(sizes)]
    arguments = {"slots": 7, "reselection": block, "allow_idle": idle, "episode_length": length}
    sync, native = pair(number, mode, bank=banks, random_start=idle, **arguments)
    actions = random_actions(seed, 30, native.action_space.shape, reselect=0.3)
    assert_equal_runs(sync, native, actions, seed)


@pytest.mark.parametrize("mode", MODES)
def test_equals_the_single_ones_on_simulated_routes(mode):
    sync, native = pair(2, mode, **EVERYTHING)
    actions = random_actions(2, 30, native.action_space.shape)
    assert assert_equal_runs(sync, native, actions, seed=11) >= 4


def test_equals_the_single_ones_under_options(bank):
    sync, native = pair(3, AutoresetMode.NEXT_STEP, bank=[bank, random_bank(2)])
    actions = random_actions(3, 60, native.action_space.shape)
    options = {"bank": 1, "start": 3, "compute_weight": 0.3}
    assert_equal_runs(sync, native, actions, [4, 4, 9], options)


@pytest.mark.parametrize("reward", ["ground_truth", "estimated"])
def test_equals_the_single_ones_under_rewards(bank, reward):
    sync, native = pair(3, AutoresetMode.SAME_STEP, bank=bank, reward=reward, random_start=True)
    actions = random_actions(3, 60, native.action_space.shape)
    assert assert_equal_runs(sync, native, actions, seed=0) >= 3


def test_route_i_is_the_single_environment_of_seed_plus_i(bank):
    arguments = {**EVERYTHING, "bank": [bank, random_bank(2)]}
    native = TechniqueSelectionVectorEnv(3, autoreset_mode="SameStep", **arguments)
    actions = random_actions(4, 11, native.action_space.shape)
    together = play(native, actions, seed=20)
    for i in range(3):
        single = TechniqueSelectionEnv(**arguments)
        alone = play(single, actions[:, i], seed=20 + i)
        for whole, part in zip(together, alone, strict=True):
            assert_same(whole[0][i], part[0])
            assert whole[-1]["prediction"][i] == part[-1]["prediction"]
            assert whole[-1]["compute_weight"][i] == part[-1]["compute_weight"]


def test_options_with_one_entry_per_route(bank):
    native = TechniqueSelectionVectorEnv(3, [bank, random_bank(2, queries=9)])
    weights = np.array([0.1, 1.0, 10.0])
    options = {"bank": np.array([0, 1, 0]), "start": np.array([4, 5, 6]), "compute_weight": weights}
    _, info = native.reset(seed=0, options=options)
    assert info["route"].tolist() == [0, 1, 0]
    assert info["compute_weight"].tolist() == weights.tolist()
    ends = [native.step(np.ones((3, 3)))[2].tolist() for _ in range(4)]
    assert ends == [[False] * 3] * 3 + [[False, True, False]]


@pytest.mark.parametrize("value", [[0.1, 1.0, 10.0], np.array([0.1]), (1,), [[1, 2]]])
@pytest.mark.parametrize("name", ["compute_weight", "start", "bank"])
def test_one_entry_per_route_is_for_the_native_one_alone(bank, name, value):
    envs = [TechniqueSelectionEnv(bank), SyncVectorEnv([lambda: TechniqueSelectionEnv(bank)] * 3)]
    for env in envs:
        with pytest.raises(ValueError, match=f"reset option {name} is .* one entry per route is"):
            env.reset(options={name: value})
        env.reset(options={name: np.int64(0), "compute_weight": np.array(0.5)})


@pytest.mark.parametrize("entries", [1, 2, 4])
def test_entries_for_another_number_of_routes_are_refused(bank, entries):
    native = TechniqueSelectionVectorEnv(3, bank)
    with pytest.raises(ValueError, match=f"'start' has {entries} entries for 3 routes; give one"):
        native.reset(options={"start": [0] * entries})


def test_a_mask_leaves_the_other_routes_alone(bank):
    masked, plain = (TechniqueSelectionVectorEnv(3, bank) for _ in range(2))
    for env in (masked, plain):
        env.reset(seed=1)
        env.step(np.ones((3, 3)))
    masked.reset(options={"reset_mask": np.array([False, True, False])})
    first, second = (env.step(np.ones((3, 3))) for env in (masked, plain))
    assert first[-1]["frame"].tolist() == [1, 0, 1]
    assert_same(first[0][[0, 2]], second[0][[0, 2]])


@pytest.mark.parametrize("mask", [[True], [False, False, False], [1, 0, 1]])
def test_wrong_masks_are_refused(bank, mask):
    native = TechniqueSelectionVectorEnv(3, bank)
    native.reset()
    with pytest.raises(ValueError, match="reset_mask"):
        native.reset(options={"reset_mask": np.array(mask)})


@pytest.mark.parametrize("mode", MODES)
def test_make_vec_passes_mode_and_length(bank, mode):
    env = gym.make_vec(
        ENV_NAME,
        num_envs=3,
        autoreset_mode=mode,
        max_episode_steps=6,
        bank=bank,
    )
    assert isinstance(env.unwrapped, TechniqueSelectionVectorEnv)
    assert env.metadata["autoreset_mode"] is mode
    assert env.num_envs == 3
    env.reset(seed=0)
    cut = [bool(env.step(np.ones((3, 3)))[3].all()) for _ in range(6)]
    assert cut == [False] * 5 + [True]
    env.close()


def test_make_vec_chooses_the_native_one(bank):
    env = gym.make_vec(ENV_NAME, num_envs=2, bank=bank, reselection=4)
    assert isinstance(env.unwrapped, TechniqueSelectionVectorEnv)
    assert env.single_action_space.shape == (4,)
    assert env.action_space.shape == (2, 4)
    env.reset(seed=0)
    assert env.action_space.contains(env.action_space.sample())
    observation = env.step(env.action_space.sample())[0]
    assert env.observation_space.contains(observation)
    env.close()


def test_a_route_that_needs_more_room_does_not_disturb_the_others(bank):
    """Routes of growing size begin one after the other while the first goes on."""
    banks = [bank, *(random_bank(i, queries=10 * i, references=70 * i) for i in range(1, 5))]
    native = TechniqueSelectionVectorEnv(2, banks, reselection=4, autoreset_mode="Disabled")
    single = TechniqueSelectionEnv(bank, reselection=4)
    native.reset(seed=0, options={"bank": 0})
    single.reset(seed=0)
    actions = random_actions(0, 40, (4,), reselect=0.2)
    for frame, action in enumerate(actions):
        if frame % 10 == 5:
            options = {"bank": 1 + frame // 10, "reset_mask": np.array([False, True])}
            native.reset(options=options)
        both, alone = native.step(np.stack([action, action])), single.step(action)
        assert_same(both[0][0], alone[0])
        assert both[-1]["confidence"][0] == alone[-1]["confidence"]


def test_render_describes_every_route(bank):
    native = TechniqueSelectionVectorEnv(2, bank, render_mode="ansi")
    assert native.render() == ("no route yet; call reset first",) * 2
    native.reset(seed=0)
    native.step([[1, 0, 0], [0, 1, 1]])
    first, second = native.render()
    assert first.startswith("bank1 frame 1/40: place ")
    assert first.endswith("ran T0")
    assert second.endswith("ran T1 + T2")
    assert TechniqueSelectionVectorEnv(2, bank).render() is None
