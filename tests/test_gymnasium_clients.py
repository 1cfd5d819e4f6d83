"""Gymnasium's own wrappers and utilities around the environment, single and native vector."""

from __future__ import annotations

import json
import warnings
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from env_cases import ENV_NAME, assert_same, random_actions, random_bank
from gymnasium import spaces, wrappers
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import performance
from gymnasium.utils.env_match import check_environments_match
from gymnasium.utils.passive_env_checker import env_render_passive_checker
from gymnasium.utils.step_api_compatibility import step_api_compatibility
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers import vector

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

pytestmark = pytest.mark.filterwarnings("ignore:.*precision lowered by casting:UserWarning")

BANK = random_bank(1, queries=9)
LENGTH, ROUTES = BANK.queries, 3
SIZE = TechniqueSelectionEnv(BANK).observation_space.shape[0]
PICTURE = {"render_mode": "rgb_array"}
UNIT = {"min_obs": np.float32(0), "max_obs": np.float32(1)}


def clipped(rewards):
    return np.clip(rewards, 0.0, 0.2)


def doubled(rewards):
    return 2.0 * np.asarray(rewards)


def flipped(action):
    return 1 - action


# Name -> how to wrap a single environment, and what it does to the rewards, if anything.
SINGLE = {
    "DelayObservation": (partial(wrappers.DelayObservation, delay=2), None),
    "DtypeObservation": (partial(wrappers.DtypeObservation, dtype=np.float16), None),
    "FlattenObservation": (wrappers.FlattenObservation, None),
    "FrameStackObservation": (partial(wrappers.FrameStackObservation, stack_size=3), None),
    "NormalizeObservation": (wrappers.NormalizeObservation, None),
    "AddRenderObservation": (wrappers.AddRenderObservation, None),
    "GrayscaleObservation": (
        lambda env: wrappers.GrayscaleObservation(wrappers.AddRenderObservation(env)),
        None,
    ),
    "ResizeObservation": (
        lambda env: wrappers.ResizeObservation(wrappers.AddRenderObservation(env), (54, 96)),
        None,
    ),
    "ReshapeObservation": (partial(wrappers.ReshapeObservation, shape=(1, SIZE)), None),
    "RescaleObservation": (
        partial(wrappers.RescaleObservation, **UNIT),
        None,
    ),
    "TransformObservation": (
        partial(
            wrappers.TransformObservation,
            func=lambda seen: seen[:4],
            observation_space=spaces.Box(-1, 1, (4,), np.float32),
        ),
        None,
    ),
    "TimeAwareObservation": (
        lambda env: wrappers.TimeAwareObservation(wrappers.TimeLimit(env, LENGTH)),
        None,
    ),
    "ClipReward": (partial(wrappers.ClipReward, min_reward=0.0, max_reward=0.2), clipped),
    "TransformReward": (partial(wrappers.TransformReward, func=doubled), doubled),
    "TimeLimit": (partial(wrappers.TimeLimit, max_episode_steps=LENGTH), None),
    "PassiveEnvChecker": (wrappers.PassiveEnvChecker, None),
    "OrderEnforcing": (wrappers.OrderEnforcing, None),
    "RecordEpisodeStatistics": (wrappers.RecordEpisodeStatistics, None),
    "RenderCollection": (wrappers.RenderCollection, None),
    "HumanRendering": (wrappers.HumanRendering, None),
    "AddWhiteNoise": (partial(wrappers.AddWhiteNoise, probability_of_noise_per_pixel=0.1), None),
    "ObstructView": (
        partial(wrappers.ObstructView, obstructed_pixels_ratio=0.1, obstruction_width=20),
        None,
    ),
}
SINGLE_APART = {  # whose steps are not the environment's, each with a test of its own
    *("MaxAndSkipObservation", "StickyAction", "RepeatAction", "TransformAction"),
    *("NormalizeReward", "Autoreset"),
}
# For other spaces, or with libraries that this project does not use.
NOT_FOR_SINGLE = {
    *("AtariPreprocessing", "FilterObservation", "ClipAction", "DiscretizeAction"),
    *("RescaleAction", "DiscretizeObservation", "ArrayConversion", "JaxToNumpy"),
    *("JaxToTorch", "NumpyToTorch", "RecordVideo"),
}

# Name -> the native vector environment, and Gymnasium's own of single ones, wrapped.
VECTOR = {
    "TransformObservation": partial(
        vector.TransformObservation,
        func=lambda seen: seen[:, :4],
        single_observation_space=spaces.Box(-1, 1, (4,), np.float32),
        observation_space=spaces.Box(-1, 1, (ROUTES, 4), np.float32),
    ),
    "VectorizeTransformObservation": partial(
        vector.VectorizeTransformObservation, wrapper=wrappers.FlattenObservation
    ),
    "VectorizeTransformAction": partial(
        vector.VectorizeTransformAction,
        wrapper=wrappers.TransformAction,
        func=flipped,
        action_space=spaces.MultiBinary(3),
    ),
    "VectorizeTransformReward": partial(
        vector.VectorizeTransformReward, wrapper=wrappers.TransformReward, func=doubled
    ),
    "FlattenObservation": vector.FlattenObservation,
    "ReshapeObservation": partial(vector.ReshapeObservation, shape=(1, SIZE)),
    "RescaleObservation": partial(
        vector.RescaleObservation, min_obs=np.float32(0), max_obs=np.float32(1)
    ),
    "DtypeObservation": partial(vector.DtypeObservation, dtype=np.float16),
    "NormalizeObservation": vector.NormalizeObservation,
    "TransformAction": partial(vector.TransformAction, func=flipped),
    "TransformReward": partial(vector.TransformReward, func=doubled),
    "ClipReward": partial(vector.ClipReward, min_reward=0.0, max_reward=0.2),
    "NormalizeReward": vector.NormalizeReward,
    "RecordEpisodeStatistics": vector.RecordEpisodeStatistics,
    "HumanRendering": vector.HumanRendering,
    "DictInfoToList": vector.DictInfoToList,
}
NOT_FOR_VECTOR = {
    *("FilterObservation", "GrayscaleObservation", "ResizeObservation", "ClipAction"),
    *("RescaleAction", "ArrayConversion", "JaxToNumpy", "JaxToTorch", "NumpyToTorch"),
    "RecordVideo",
}


def single(**arguments) -> TechniqueSelectionEnv:
    return TechniqueSelectionEnv(BANK, **{"compute_weight": (0.1, 3.0), **arguments})


def native(number: int = ROUTES, **arguments) -> TechniqueSelectionVectorEnv:
    return TechniqueSelectionVectorEnv(number, BANK, **{"compute_weight": (0.1, 3.0), **arguments})


def sync(mode: AutoresetMode, **arguments) -> SyncVectorEnv:
    return SyncVectorEnv([partial(single, **arguments)] * ROUTES, autoreset_mode=mode)


def test_every_wrapper_is_tried_or_named_as_one_that_cannot_apply():
    assert {*SINGLE, *SINGLE_APART, *NOT_FOR_SINGLE, "vector"} == set(wrappers.__all__)
    assert {*VECTOR, *NOT_FOR_VECTOR} == set(vector.__all__)


@pytest.mark.parametrize("name", SINGLE)
def test_a_wrapped_environment_gives_what_the_bare_one_gives(name):
    wrap, changes = SINGLE[name]
    bare, env = single(), wrap(single(**PICTURE))
    assert env.unwrapped.spec is None
    bare.reset(seed=4)
    seen, _ = env.reset(seed=4)
    assert seen in env.observation_space
    for number, action in enumerate(random_actions(2, LENGTH, env.action_space.shape)):
        assert action in env.action_space
        wanted, got = bare.step(action), env.step(action)
        assert got[0] in env.observation_space
        assert got[1] == (wanted[1] if changes is None else changes(wanted[1]))
        assert got[2] == wanted[2] == (number == LENGTH - 1)
        assert got[3] == (wanted[3] or (name in ("TimeLimit", "TimeAwareObservation") and got[2]))
        assert_same({key: got[4][key] for key in wanted[4]}, wanted[4])
    env.close()


def test_wrappers_that_repeat_or_change_actions_do_so():
    actions = random_actions(3, 3, (3,))
    bare, env = single(), wrappers.TransformAction(single(), flipped, single().action_space)
    assert_same(bare.reset(seed=1), env.reset(seed=1))
    for action in actions:
        assert_same(bare.step(action), env.step(1 - action))
    for wrap in (
        partial(wrappers.RepeatAction, num_repeats=2),
        partial(wrappers.MaxAndSkipObservation, skip=2),
    ):
        bare, env = single(), wrap(single())
        assert_same(bare.reset(seed=1)[0], env.reset(seed=1)[0])
        for action in actions:
            both = [bare.step(action)[1] for _ in range(2)]
            assert env.step(action)[1] == sum(both)
    env = wrappers.StickyAction(single(), 1.0 - 1e-12)
    env.reset(seed=1)
    assert env.step(actions[0])[4]["ran"].tolist() == actions[0].astype(bool).tolist()
    assert env.step(1 - actions[0])[4]["ran"].tolist() == actions[0].astype(bool).tolist()


def test_autoreset_begins_anew_after_the_end():
    env, bare = wrappers.Autoreset(single()), single()
    assert_same(env.reset(seed=1), bare.reset(seed=1))
    for action in random_actions(3, LENGTH, (3,)):
        assert_same(env.step(action), bare.step(action))
    assert_same(env.step(action)[0], bare.reset()[0])


def test_normalised_rewards_are_finite_and_in_proportion():
    env, bare = wrappers.NormalizeReward(single()), single()
    env.reset(seed=1)
    bare.reset(seed=1)
    for action in random_actions(3, LENGTH, (3,)):
        normalised, plain = env.step(action)[1], bare.step(action)[1]
        assert np.isfinite(normalised)
        assert np.sign(normalised) == np.sign(plain)


MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]


@pytest.mark.parametrize(
    ("name", "mode"),
    [(n, m) for n in VECTOR for m in MODES[: 1 if n.endswith("Observation") else 2]],
)
def test_a_wrapped_vector_gives_what_gymnasiums_own_gives(name, mode):
    picture = PICTURE if name == "HumanRendering" else {}
    envs = [sync(mode, **picture), native(autoreset_mode=mode, **picture)]
    if name == "DictInfoToList":
        assert VECTOR[name](envs[1]).reset(seed=3)[1][2]["frame"] == -1
    envs = envs if name == "DictInfoToList" else [VECTOR[name](env) for env in envs]
    assert all(isinstance(env, VectorEnv) for env in envs)
    first, second = (env.reset(seed=3) for env in envs)
    assert_same(first, second)
    for action in random_actions(1, 2 * LENGTH + 3, envs[0].action_space.shape):
        first, second = (env.step(action.copy()) for env in envs)  # a wrapper may write to it
        for steps in (first, second):
            steps[4].get("episode", {}).pop("t", None)  # seconds that it took
        assert_same(first, second)
        assert second[0] in envs[1].observation_space
    for env in envs:
        env.close()


# ---- what clients ask of a vector environment ----------------------------------------------


def test_seeds_and_generators_are_those_of_the_routes():
    envs = [sync(AutoresetMode.NEXT_STEP), native()]
    assert len(set(envs[1].np_random_seed)) == ROUTES  # drawn
    for seed in (7, [3, 1, 4], [5, None, 6]):
        for env in envs:
            env.reset(seed=seed)
        seeds = [env.np_random_seed for env in envs]
        assert seeds[0] == seeds[1]
    assert seeds[1] == (5, 1, 6)
    first, second = ([each.random() for each in env.np_random] for env in envs)
    assert first == second
    assert vector.FlattenObservation(envs[1]).np_random_seed == (5, 1, 6)


def test_attributes_and_calls_are_as_those_of_gymnasiums_own():
    envs = [sync(AutoresetMode.NEXT_STEP, **PICTURE), native(**PICTURE)]
    for env in envs:
        env.reset(seed=2)
    for name in ("np_random_seed", "observation_space", "action_space", "render_mode"):
        first, second = (env.get_attr(name) for env in envs)
        assert first == second
    for first, second in zip(*(env.call("render") for env in envs), strict=True):
        np.testing.assert_array_equal(first, second)
    assert native().call("render") == (None,) * ROUTES
    envs[1].set_attr("mark", 5)
    assert envs[1].get_attr("mark") == (5,) * ROUTES
    envs[1].set_attr("mark", [6] * ROUTES)
    assert envs[1].mark == 6
    with pytest.raises(ValueError, match="the routes share it"):
        envs[1].set_attr("mark", [1, 2, 3])
    with pytest.raises(AttributeError, match=r"call reset\(\) of them all"):
        envs[1].call("reset")
    with pytest.raises(AttributeError, match="nothing"):
        envs[1].get_attr("nothing")


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_lists_of_pictures_are_those_of_gymnasiums_collection(mode):
    def collected():
        return wrappers.RenderCollection(single(**PICTURE))

    own = SyncVectorEnv([collected] * ROUTES, autoreset_mode=mode)
    env = native(autoreset_mode=mode, render_mode="rgb_array_list")
    alone = single(render_mode="rgb_array_list")
    for each in (own, env, alone):
        each.reset(seed=1, options={"start": LENGTH - 3})
    actions = np.ones((ROUTES, 3), np.int8)
    for number in range(3 if mode is AutoresetMode.DISABLED else 5):
        own.step(actions)
        env.step(actions)
        if number < 3:
            alone.step(actions[0])
        if number in (1, 2, 4):
            first, second = own.render(), env.render()
            assert [len(each) for each in first] == [len(each) for each in second]
            assert_same([list(each) for each in first], [list(each) for each in second])
            if number == 1:
                assert_same(alone.render(), second[0])
                assert alone.render() == []


def test_make_takes_lists_of_pictures_single_and_vector():
    env = gym.make(ENV_NAME, bank=BANK, render_mode="rgb_array_list")
    env.reset(seed=0)
    env.step([1, 0, 0])
    assert len(env.render()) == 2
    envs = gym.make_vec(ENV_NAME, 2, bank=BANK, render_mode="rgb_array_list")
    envs.reset(seed=0)
    assert [len(pictures) for pictures in envs.render()] == [1, 1]


# ---- specifications ------------------------------------------------------------------------


def test_a_specification_is_json_and_makes_the_same_environment(tmp_path):
    folder = BANK.save(tmp_path / "bank")
    loaded = ScoreBank.load(folder)
    for bank in (folder, str(folder), loaded, [loaded, folder]):
        env = gym.make(ENV_NAME, bank=bank, compute_weight=(0.1, 3.0))
        text = env.spec.to_json()
        same = gym.make(EnvSpec.from_json(text))
        assert_same(env.reset(seed=3), same.reset(seed=3))
        assert_same(env.step([1, 0, 1]), same.step([1, 0, 1]))
        assert json.loads(text) == json.loads(same.spec.to_json())
    for mode in ("SameStep", AutoresetMode.SAME_STEP):
        env = gym.make_vec(ENV_NAME, 2, bank=loaded, autoreset_mode=mode)
        same = gym.make_vec(EnvSpec.from_json(env.spec.to_json()))
        assert same.num_envs == 2
        assert same.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
        assert_same(env.reset(seed=3), same.reset(seed=3))


def test_what_no_text_can_stand_for_stays_what_it_is(tmp_path):
    loaded = ScoreBank.load(BANK.save(tmp_path / "bank"))
    views = [BANK, loaded.with_costs("runs"), loaded.subset(BANK.techniques[::-1])]
    for bank in views:
        env = gym.make(ENV_NAME, bank=bank)
        assert env.spec.kwargs["bank"] is bank
        with pytest.raises(TypeError, match="not JSON serializable"):
            env.spec.to_json()
        assert gym.make(env.spec).unwrapped.task.source.banks[0] is bank


# ---- utilities -----------------------------------------------------------------------------


def test_environments_match_and_their_speed_can_be_measured():
    check_environments_match(single(), single(), 2 * LENGTH, seed=1, info_comparison="equivalence")
    assert performance.benchmark_step(single(), target_duration=0.02, seed=1) > 0
    assert performance.benchmark_vector_step(native(), target_duration=0.02, seed=1) > 0
    assert performance.benchmark_init(single, target_duration=0.02, seed=1) > 0
    assert performance.benchmark_render(single(**PICTURE), target_duration=0.02) > 0


@pytest.mark.parametrize("mode", ["ansi", "rgb_array", "rgb_array_list", "human"])
def test_what_is_shown_is_what_gymnasium_expects_of_the_mode(mode):
    env = single(render_mode=mode)
    env.reset(seed=0)
    env.step([1, 0, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env_render_passive_checker(env)
    env.close()


def test_steps_convert_to_the_older_interface():
    env = single()
    env.reset(seed=0)
    for _ in range(LENGTH):
        _, _, done, info = step_api_compatibility(env.step([1, 0, 0]), output_truncation_bool=False)
    assert done
    assert info["TimeLimit.truncated"] is False
