"""What Stable-Baselines3 sees through the adapter is the native vector environment."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from amusic_agents.adapter import SB3VecEnv
from env_cases import assert_same, random_actions, random_bank
from gymnasium.wrappers import vector
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.observation import ROUTE_FEATURES
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

pytestmark = pytest.mark.slow

BANKS = [random_bank(1), random_bank(2, queries=7, references=90), random_bank(3, queries=25)]


def native(number: int = 4, **arguments) -> TechniqueSelectionVectorEnv:
    options = {"bank": BANKS, "compute_weight": (0.1, 3.0), "autoreset_mode": "SameStep"}
    return TechniqueSelectionVectorEnv(number, **{**options, **arguments})


@pytest.mark.parametrize(
    "arguments", [{}, {"episode_length": 5, "random_start": True, "reselection": 3}]
)
def test_equals_the_native_environment_step_by_step(arguments):
    env, wrapped = native(**arguments), SB3VecEnv(native(**arguments))
    assert wrapped.num_envs == 4
    assert wrapped.observation_space == env.single_observation_space
    assert wrapped.action_space == env.single_action_space
    wrapped.seed(7)
    first, _ = env.reset(seed=7)
    np.testing.assert_array_equal(wrapped.reset(), first)
    past: list[list[dict[str, float]]] = [[] for _ in range(4)]
    cut = []
    for action in random_actions(1, 90, env.action_space.shape):
        expected, reward, terminated, truncated, info = env.step(action)
        observation, rewards, done, infos = wrapped.step(action.astype(np.float32))
        np.testing.assert_array_equal(observation, expected)
        np.testing.assert_array_equal(rewards, reward.astype(np.float32))
        assert rewards.dtype == np.float32
        np.testing.assert_array_equal(done, terminated | truncated)
        for i in range(4):
            source = info["final_info"] if done[i] else info
            terms = {k: v[i] for k, v in source["reward_terms"].items() if k[0] != "_"}
            past[i].append({"reward": reward[i], **terms})
            if not done[i]:
                assert infos[i] == {}
                continue
            assert_ended(infos[i], info["final_obs"][i], truncated[i], past[i])
            cut.append(bool(truncated[i]))
            past[i] = []
    assert len(cut) > 8
    assert any(cut) == bool(arguments)
    assert not all(cut)


def assert_ended(info, last, truncated, past) -> None:
    """The info of an ended episode against all its steps."""
    np.testing.assert_array_equal(info["terminal_observation"], last)
    assert info["TimeLimit.truncated"] is bool(truncated)
    assert info["episode"]["l"] == len(past)
    assert info["episode"]["r"] == pytest.approx(sum(step["reward"] for step in past))
    terms = info["episode"]["reward_terms"]
    assert set(terms) == {"correctness", "compute"}
    for name, value in terms.items():
        assert value == pytest.approx(np.mean([step[name] for step in past]))
    total = sum(terms.values()) * len(past)
    assert total == pytest.approx(info["episode"]["r"])


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_refuses_another_autoreset_mode(mode):
    with pytest.raises(ValueError, match=f"'{mode}'.*autoreset_mode='SameStep'"):
        SB3VecEnv(native(autoreset_mode=mode))


def test_gymnasiums_vector_wrappers_may_be_around_the_environment():
    plain = SB3VecEnv(native())
    wrapped = SB3VecEnv(vector.RecordEpisodeStatistics(vector.ClipReward(native(), 0.0, 0.1)))
    for env in (plain, wrapped):
        env.seed(7)
    np.testing.assert_array_equal(plain.reset(), wrapped.reset())
    ended = 0
    for action in random_actions(1, 30, (4, 3)):
        (first, rewards, done, infos), (second, clipped, *rest) = (
            env.step(action) for env in (plain, wrapped)
        )
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(np.clip(rewards, 0.0, 0.1), clipped)
        np.testing.assert_array_equal(done, rest[0])
        ended += sum(
            one["episode"]["l"] == two["episode"]["l"]
            for one, two in zip(infos, rest[1], strict=True)
            if one
        )
    assert ended > 2
    assert wrapped.env_is_wrapped(vector.ClipReward) == [True] * 4
    assert wrapped.env_is_wrapped(vector.NormalizeReward) == [False] * 4
    assert wrapped.get_attr("task")[0].slots == 3
    assert wrapped.get_attr("length_queue")[0].maxlen == 100
    wrapped.set_attr("mark", 5)
    assert wrapped.env.unwrapped.mark == 5
    with pytest.raises(ValueError, match="ClipReward with autoreset mode 'NextStep'"):
        SB3VecEnv(vector.ClipReward(native(autoreset_mode="NextStep"), 0.0, 0.1))


def test_a_seed_counts_for_the_next_reset_only():
    wrapped = SB3VecEnv(native(random_start=True, episode_length=5))
    assert wrapped.seed(3) == [3, 4, 5, 6]
    first = wrapped.reset()
    other = wrapped.reset()
    wrapped.seed(3)
    np.testing.assert_array_equal(wrapped.reset(), first)
    np.testing.assert_array_equal(wrapped.reset(), other)
    assert not np.array_equal(first, other)


def test_options_of_each_route_count_for_the_next_reset_only():
    wrapped, env = SB3VecEnv(native(2)), native(2)
    wrapped.set_options([{"bank": 1, "compute_weight": 0.5}, {"bank": 2, "compute_weight": 2.0}])
    expected, _ = env.reset(options={"bank": [1, 2], "compute_weight": [0.5, 2.0]})
    np.testing.assert_array_equal(wrapped.reset(), expected)
    done = [wrapped.step(np.ones((2, 3)))[2].tolist() for _ in range(7)]
    assert done == [[False, False]] * 6 + [[True, False]]  # bank 1 has seven frames
    position = ROUTE_FEATURES.index("compute_weight") - len(ROUTE_FEATURES)
    weights = {tuple(wrapped.reset()[:, position]) for _ in range(3)}
    assert len(weights) == 3  # drawn again
    wrapped.set_options({"compute_weight": 1.0})
    assert np.ptp(wrapped.reset()[:, position]) == 0


def test_options_of_other_names_on_every_route_are_refused():
    wrapped = SB3VecEnv(native(2))
    wrapped.set_options([{"bank": 1}, {}])
    with pytest.raises(ValueError, match="same things for every route"):
        wrapped.reset()


def test_attributes_and_methods_reach_the_wrapped_environment():
    env = native(3, render_mode="ansi")
    wrapped = SB3VecEnv(env)
    wrapped.reset()
    assert wrapped.get_attr("task") == [env.task] * 3
    assert wrapped.get_attr("num_envs", indices=[0, 2]) == [3, 3]
    assert wrapped.get_attr("num_envs", indices=1) == [3]
    assert wrapped.has_attr("task")
    assert not wrapped.has_attr("nothing")
    wrapped.set_attr("mark", 5)
    assert env.mark == 5
    assert wrapped.env_method("render", indices=0) == [env.render()]
    assert wrapped.env_is_wrapped(gym.Wrapper) == [False] * 3
    assert wrapped.render_mode == "ansi"
    wrapped.close()
    wrapped.close()


def test_pictures_of_every_route_come_through():
    wrapped = SB3VecEnv(native(2, render_mode="rgb_array"))
    wrapped.reset()
    pictures = wrapped.get_images()
    assert len(pictures) == 2
    assert pictures[0].dtype == np.uint8
    assert pictures[0].shape == pictures[1].shape
    tiled = wrapped.render()
    assert tiled.shape[0] * tiled.shape[1] >= 2 * pictures[0].shape[0] * pictures[0].shape[1]
    assert wrapped.metadata["render_fps"] > 0
    wrapped.close()


def test_evaluate_policy_takes_the_episodes_as_a_monitors():
    bank = random_bank(4, queries=9)
    env = SB3VecEnv(native(2, bank=bank, compute_weight=0.5))
    model = PPO("MlpPolicy", env, n_steps=4, batch_size=8, seed=0, device="cpu")
    returns, lengths = evaluate_policy(model, env, 5, return_episode_rewards=True)
    assert lengths == [9] * 5
    expected = whole_episode(model, bank)
    assert returns == pytest.approx([expected] * 5, rel=1e-5)


def whole_episode(model: PPO, bank: ScoreBank) -> float:
    env = native(1, bank=bank, compute_weight=0.5)
    observation, _ = env.reset()
    total = 0.0
    for _ in range(bank.queries):
        action, _ = model.predict(observation, deterministic=True)
        observation, reward, *_ = env.step(action)
        total += float(reward[0])
    return total


def test_ppo_learns_through_it_and_a_cut_episode_is_bootstrapped():
    env = SB3VecEnv(native(4, episode_length=3))
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(64)
    assert model.num_timesteps == 64
    assert model.ep_info_buffer
    assert {episode["l"] for episode in model.ep_info_buffer} <= {1, 2, 3}
    assert env.env_is_wrapped(Monitor) == [True] * 4  # it tells of episodes as Monitor does


def test_one_route_works_alone():
    wrapped = SB3VecEnv(native(1, bank=random_bank(5, queries=2)))
    wrapped.reset()
    action = np.ones((1, 3))
    ends = [(done[0], len(infos[0])) for _, _, done, infos in map(wrapped.step, [action] * 4)]
    assert ends == [(False, 0), (True, 3)] * 2


def test_what_is_written_to_an_info_stays_in_that_step(bank):
    env = SB3VecEnv(native(bank=bank))
    env.reset()
    actions = np.ones((4, 3), np.int8)
    steps = [env.step(actions)[3] for _ in range(3)]
    for number, infos in enumerate(steps):
        infos[1]["step"] = number
    assert [infos[1] for infos in steps] == [{"step": 0}, {"step": 1}, {"step": 2}]
    assert steps[0][0] == {}


@pytest.mark.parametrize("arguments", [{}, {"episode_length": 5, "reselection": 3, "slots": 4}])
def test_infos_on_request_are_those_of_single_environments(arguments):
    options = {"bank": BANKS, "compute_weight": (0.1, 3.0), **arguments}
    env = SB3VecEnv(native(**arguments), infos=True)
    own = DummyVecEnv([partial(TechniqueSelectionEnv, **options)] * 4)
    for each in (env, own):
        each.seed(7)
    np.testing.assert_array_equal(env.reset(), own.reset())
    assert_same(env.reset_infos, own.reset_infos)
    ended = 0
    for action in random_actions(1, 60, (4, *env.action_space.shape)):
        got, wanted = env.step(action), own.step(action)
        np.testing.assert_array_equal(got[2], wanted[2])
        for one, other in zip(got[3], wanted[3], strict=True):
            ended += "episode" in one
            one.pop("episode", None)
            other_ended = other.pop("TimeLimit.truncated")
            assert one.pop("TimeLimit.truncated", False) is other_ended
            assert_same(one, other)
        assert_same(env.reset_infos, own.reset_infos)
    assert ended > 4
