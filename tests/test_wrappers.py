"""Actions in numbers instead of bits: the same steps, and masks that say what is possible."""

from __future__ import annotations

import copy
import json
from functools import partial
from itertools import combinations

import gymnasium as gym
import numpy as np
import pytest
from amusic_agents.adapter import SB3VecEnv
from env_cases import ENV_NAME, assert_same, random_bank
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.envs.wrappers import (
    DiscreteSubsets,
    MultiDiscreteBits,
    VectorDiscreteSubsets,
    VectorMultiDiscreteBits,
)

BANK = random_bank(1, queries=9)  # seconds 1, 2, 3
MIXED = [random_bank(2, techniques=2, queries=7), random_bank(3, techniques=4, queries=5)]
ROUTES = 3
SINGLE = {DiscreteSubsets: VectorDiscreteSubsets, MultiDiscreteBits: VectorMultiDiscreteBits}


def all_subsets(techniques: int) -> list[set[int]]:
    found = [set(c) for n in range(techniques + 1) for c in combinations(range(techniques), n)]
    return sorted(found, key=lambda members: sum(2**t for t in members))


def possible(info, budget: float = 1.0, idle: bool = False) -> list[set[int]]:
    """The subsets that an info's techniques and costs leave, worked out one by one."""
    cost, present = info["run_seconds"], set(np.flatnonzero(info["present"]).tolist())
    cheapest = {min(present, key=lambda t: cost[t])}
    return [
        members
        for members in all_subsets(len(cost))
        if members <= present
        and (members or idle)
        and (members == cheapest or sum(cost[t] for t in members) <= budget * cost.sum() + 1e-9)
    ]


def allowed(env, mask) -> list[set[int]]:
    return [set(np.flatnonzero(env.subsets[a]).tolist()) for a in np.flatnonzero(mask)]


@pytest.mark.parametrize(
    ("arguments", "actions"),
    [({}, 7), ({"allow_idle": True}, 8), ({"reselection": 5}, 8), ({"slots": 4}, 15)],
)
def test_subsets_are_numbered_by_their_bits(arguments, actions):
    env = DiscreteSubsets(TechniqueSelectionEnv(BANK, **arguments))
    assert env.action_space == spaces.Discrete(actions)
    first = 0 if arguments.get("allow_idle") else 1
    assert allowed(env, np.ones(len(env.subsets))) == all_subsets(arguments.get("slots", 3))[first:]
    bits = np.array([env.bits(a) for a in range(actions)])
    assert bits.shape == (actions, *env.unwrapped.action_space.shape)
    assert len(np.unique(bits, axis=0)) == actions
    if "reselection" in arguments:
        assert bits[-1].tolist() == [0, 0, 0, 1]
        assert not bits[:-1, -1].any()


def test_bits_are_a_number_each():
    env = MultiDiscreteBits(TechniqueSelectionEnv(BANK, reselection=5))
    assert env.action_space == spaces.MultiDiscrete([2, 2, 2, 2])
    envs = VectorMultiDiscreteBits(TechniqueSelectionVectorEnv(ROUTES, BANK))
    assert envs.single_action_space == spaces.MultiDiscrete([2, 2, 2])
    assert envs.action_space.shape == (ROUTES, 3)


@pytest.mark.parametrize("wrapper", SINGLE)
def test_a_step_is_that_of_the_bits(wrapper):
    bare, env = (TechniqueSelectionEnv(BANK, reselection=4) for _ in range(2))
    env = wrapper(env)
    env.action_space.seed(0)
    assert_same(bare.reset(seed=3)[0], env.reset(seed=3)[0])
    for _ in range(BANK.queries):
        action = env.action_space.sample()
        first, second = bare.step(env.bits(action)), env.step(action)
        mask = second[4].pop("action_mask")
        assert_same(first, second)
        assert mask.all()
        assert env.action_masks().tolist() == mask.ravel().astype(bool).tolist()
    assert second[2]


def wrapped(wrapper, **arguments):
    return wrapper(TechniqueSelectionEnv(**arguments))


@pytest.mark.parametrize("wrapper", SINGLE)
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_vector_is_the_single_ones(wrapper, mode):
    """Bit for bit, with routes that lack techniques, through ends and resets."""
    arguments = {"bank": MIXED, "slots": 5, "compute_weight": (0.1, 3.0)}
    sync = SyncVectorEnv([partial(wrapped, wrapper, **arguments)] * ROUTES, autoreset_mode=mode)
    native = TechniqueSelectionVectorEnv(ROUTES, **arguments, autoreset_mode=mode)
    native = SINGLE[wrapper](native)
    assert native.single_action_space == sync.single_action_space
    assert native.action_space == sync.action_space
    assert native.autoreset_mode is mode
    first, second = (env.reset(seed=3) for env in (sync, native))
    assert_same(first, second)
    sync.action_space.seed(0)
    for _ in range(18):
        masks = np.array(sync.call("action_masks"))
        np.testing.assert_array_equal(masks, native.action_masks())
        action = sync.action_space.sample()
        first, second = (env.step(action) for env in (sync, native))
        assert_same(first, second)
        ended = second[2] | second[3]
        if mode is AutoresetMode.DISABLED and ended.any():
            resets = (env.reset(options={"reset_mask": ended}) for env in (sync, native))
            assert_same(*resets)
    sync.close()


def test_workers_tell_their_masks():
    make = partial(wrapped, DiscreteSubsets, bank=MIXED, slots=5)
    envs = AsyncVectorEnv([make] * 2)
    _, info = envs.reset(seed=1)
    np.testing.assert_array_equal(np.array(envs.call("action_masks")), info["action_mask"] == 1)
    envs.close()


@pytest.mark.parametrize("budget", [0.05, 0.3, 0.5, 1.0])
def test_masks_leave_what_a_simulated_route_may_run(budget):
    envs = gym.make_vec(ENV_NAME, 4, autoreset_mode="SameStep", episode_length=3)
    envs = VectorDiscreteSubsets(envs, budget)
    _, info = envs.reset(seed=2)
    assert envs.single_action_space.n == 15  # costs differ from route to route
    seen = set()
    envs.action_space.seed(1)
    for _ in range(7):
        for i, mask in enumerate(info["action_mask"]):
            own = {name: info[name][i] for name in ("run_seconds", "present")}
            assert allowed(envs, mask) == possible(own, budget)
            seen.add(mask.tobytes())
        actions = envs.action_space.sample(tuple(info["action_mask"]))
        *_, info = envs.step(actions)
    assert len(seen) > 2 or budget == 1.0


@pytest.mark.parametrize(
    ("budget", "left"),
    [
        (0.5, [{0}, {1}, {0, 1}, {2}]),  # 1/6, 2/6, 3/6, 3/6 of the seconds
        (0.49, [{0}, {1}]),
        (0.01, [{0}]),
        (None, all_subsets(3)[1:]),
    ],
)
def test_known_costs_leave_dear_subsets_out_of_the_space(budget, left):
    env = DiscreteSubsets(TechniqueSelectionEnv(BANK), budget)
    assert env.action_space.n == len(left)
    assert env.reset(seed=0)[1]["action_mask"].all()
    assert allowed(env, env.action_masks()) == left
    idle = DiscreteSubsets(TechniqueSelectionEnv(BANK, allow_idle=True), budget)
    assert idle.action_space.n == 1 + len(left)


def test_banks_of_other_costs_keep_what_is_cheap_on_any():
    cheap = random_bank(4, queries=9)
    cheap = type(cheap)(
        cheap.scores, cheap.techniques, [3.0, 2.0, 1.0], tolerance=2, ground_truth=cheap.truth
    )
    env = DiscreteSubsets(TechniqueSelectionEnv([BANK, cheap]), 0.2)
    assert [set(np.flatnonzero(s)) for s in env.subsets] == [{0}, {2}]
    assert env.reset(options={"bank": 0})[1]["action_mask"].tolist() == [1, 0]
    assert env.reset(options={"bank": 1})[1]["action_mask"].tolist() == [0, 1]
    with pytest.raises(ValueError, match=r"action 0 costs 50% .* budget is 20%; .*action_masks"):
        env.step(0)
    assert env.step(1)[4]["ran"].tolist() == [False, False, True]


def test_absent_techniques_are_masked_and_harmless():
    env = DiscreteSubsets(TechniqueSelectionEnv(MIXED, slots=5))
    _, info = env.reset(options={"bank": 0})
    assert allowed(env, info["action_mask"]) == [{0}, {1}, {0, 1}]
    assert env.step(30)[4]["ran"].tolist() == [True, True, False, False, False]
    bits = MultiDiscreteBits(TechniqueSelectionEnv(MIXED, slots=5))
    _, info = bits.reset(options={"bank": 0})
    assert info["action_mask"].tolist() == [[1, 1]] * 2 + [[1, 0]] * 3
    assert not bits.action_space.sample(tuple(info["action_mask"]))[2:].any()


@pytest.mark.parametrize("action", [-1, 7, 0.5, np.nan, [1], [1, 0, 0], "a", None])
def test_other_actions_are_refused(action):
    env = DiscreteSubsets(TechniqueSelectionEnv(BANK))
    env.reset()
    with pytest.raises(ValueError, match=r"give Discrete\(7\)"):
        env.step(action)
    envs = VectorDiscreteSubsets(TechniqueSelectionVectorEnv(2, BANK))
    envs.reset()
    with pytest.raises(ValueError, match=r"give MultiDiscrete\(\[7 7\]\)"):
        envs.step(action if np.ndim(action) else [0, action])


def test_numbers_of_any_kind_are_taken():
    env = DiscreteSubsets(TechniqueSelectionEnv(BANK))
    env.reset(seed=0)
    for action in (4, 4.0, np.int64(4), np.array(4), np.float32(4)):
        assert env.step(action)[4]["ran"].tolist() == [True, False, True]


@pytest.mark.parametrize("budget", [0.0, -1.0, 1.1, np.nan, "half", True])
def test_budgets_out_of_range_are_refused(budget):
    with pytest.raises(ValueError, match="budget"):
        DiscreteSubsets(TechniqueSelectionEnv(BANK), budget)


def test_what_cannot_be_wrapped_is_refused():
    with pytest.raises(ValueError, match="re-selection runs what it needs"):
        DiscreteSubsets(TechniqueSelectionEnv(BANK, reselection=5), 0.5)
    with pytest.raises(ValueError, match="2047 subsets.*at most 10, or take MultiDiscreteBits"):
        DiscreteSubsets(TechniqueSelectionEnv(BANK, slots=11))
    with pytest.raises(ValueError, match="CartPole.*no technique selection"):
        MultiDiscreteBits(gym.make("CartPole-v1"))
    with pytest.raises(TypeError, match="VectorEnv"):
        VectorDiscreteSubsets(TechniqueSelectionEnv(BANK))
    with pytest.raises(TypeError, match=r"gymnasium\.Env"):
        DiscreteSubsets(TechniqueSelectionVectorEnv(2, BANK))


@pytest.mark.parametrize("wrapper", SINGLE)
def test_checkers_accept_it(wrapper):
    env = wrapper(gym.make(ENV_NAME, bank=BANK).unwrapped)
    sb3_check_env(env)
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(env, skip_render_check=True)


def test_a_specification_is_json_and_makes_the_same(tmp_path):
    env = DiscreteSubsets(gym.make(ENV_NAME, bank=BANK.save(tmp_path / "bank")), budget=0.5)
    text = env.spec.to_json()
    assert json.loads(text)["additional_wrappers"][0]["kwargs"] == {"budget": 0.5}
    same = gym.make(EnvSpec.from_json(text))
    assert same.action_space == env.action_space == spaces.Discrete(4)
    assert_same(env.reset(seed=3), same.reset(seed=3))
    assert_same(env.step(3), same.step(3))
    twin = copy.deepcopy(env)
    assert_same(env.step(1), twin.step(1))
    np.testing.assert_array_equal(env.action_masks(), twin.action_masks())


def test_stable_baselines_gets_the_masks_of_each_route():
    native = TechniqueSelectionVectorEnv(ROUTES, MIXED, slots=5, autoreset_mode="SameStep")
    env = SB3VecEnv(VectorDiscreteSubsets(native))
    assert env.action_space == spaces.Discrete(31)
    env.set_options([{"bank": 0}, {"bank": 1}, {"bank": 1}])
    env.reset()
    assert env.has_attr("action_masks")
    masks = np.stack(env.env_method("action_masks"))
    np.testing.assert_array_equal(masks, env.env.action_masks())
    assert masks.sum(1).tolist() == [3, 15, 15]
    np.testing.assert_array_equal(env.env_method("action_masks", indices=[2])[0], masks[2])
    env.step(masks.argmax(1))
