"""The single environment: contracts, spaces, observation, rewards, infos, episodes, banks."""

from __future__ import annotations

import doctest
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from env_cases import (
    ENV_NAME,
    EVERYTHING,
    REGISTERED,
    assert_same,
    infos_of,
    play,
    random_actions,
    random_bank,
)
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from oracle import STATISTICS as DIAGONAL
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs import env as env_module
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.observation import (
    observation_names,
    observation_size,
)
from amusic_gym.envs.rewards import RewardInputs
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.prediction import IDLE_DECAY
from amusic_gym.estimation.settings import STATISTICS

ARGUMENTS = [
    {},
    {"reselection": 5},
    {"allow_idle": True, "statistic": "mean"},
    {**EVERYTHING, "slots": 6, "render_mode": "ansi"},
]


# ---- contracts ---------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", ARGUMENTS)
@pytest.mark.parametrize("name", REGISTERED)
def test_gymnasium_accepts_it(name, arguments):
    check_env(gym.make(f"amusic_gym:{name}", **arguments).unwrapped)  # a warning is an error


@pytest.mark.parametrize("arguments", ARGUMENTS)
@pytest.mark.parametrize("name", REGISTERED)
def test_stable_baselines_accepts_it(name, arguments):
    check_env_sb3(gym.make(f"amusic_gym:{name}", **arguments).unwrapped)


def test_docstring_example_works():
    tests = doctest.DocTestFinder(recurse=False).find(
        TechniqueSelectionEnv, "env", globs=vars(env_module).copy()
    )
    assert sum(len(test.examples) for test in tests) >= 5
    for test in tests:
        assert doctest.DocTestRunner().run(test).failed == 0


@pytest.mark.parametrize("arguments", [{}, {"reselection": 5}, {"slots": 5}])
def test_spaces(bank, arguments):
    env = TechniqueSelectionEnv(bank, **arguments)
    slots = arguments.get("slots", 3)
    assert env.action_space == gym.spaces.MultiBinary(slots + ("reselection" in arguments))
    assert env.observation_space.shape == (observation_size(slots),)
    assert env.observation_space.dtype == np.float32
    assert np.all(env.observation_space.high == 1)
    assert np.all(env.observation_space.low == -1)


# ---- infos and rewards -------------------------------------------------------------------


def shapes(value):
    if isinstance(value, dict):
        return {key: shapes(part) for key, part in value.items()}
    return (value.dtype, value.shape) if isinstance(value, np.ndarray) else type(value)


@pytest.mark.parametrize("arguments", ARGUMENTS)
def test_infos_are_of_one_form_and_finite(bank, arguments):
    env = TechniqueSelectionEnv(bank, **arguments)
    infos = [item[-1] for item in play(env, random_actions(1, 60, env.action_space.shape))]
    assert all(shapes(info) == shapes(infos[0]) for info in infos)
    assert not any("truth" in key or key in ("correct", "error") for key in infos[0])
    for info in infos:
        numbers = [np.ravel(v) for v in info.values() if not isinstance(v, dict)]
        assert np.isfinite(np.concatenate(numbers, dtype=np.float64)).all()
        unrun = ~info["ran"]
        for key in ("place", "statistic", "correction"):
            assert not info[key][unrun].any()


@pytest.mark.parametrize("reward", ["estimated", "ground_truth"])
def test_terms_sum_to_the_reward(bank, reward):
    env = TechniqueSelectionEnv(bank, reward=reward, compute_weight=0.7, reselection=4)
    env.reset(seed=0)
    for frame, action in enumerate(random_actions(2, 40, (4,), reselect=0.2)):
        _, value, _, _, info = env.step(action)
        terms = info["reward_terms"]
        assert value == sum(terms.values())
        late = info["selection"]["late_runs"]
        seconds = (info["ran"] + late) @ bank.seconds
        assert info["seconds"] == pytest.approx(seconds)
        assert terms["compute"] == pytest.approx(-0.7 * seconds / bank.seconds.sum())
        right = abs(info["prediction"] - frame) <= 2
        expected = info["p_correct"] if reward == "estimated" else float(right)
        assert terms["correctness"] == expected


@pytest.mark.parametrize("statistic", STATISTICS)
def test_no_prediction_is_wrong(statistic):
    truth = np.zeros((6, 5), bool)
    truth[:, -1] = True  # truth[q, -1] must not be read
    bank = ScoreBank(np.zeros((1, 6, 5)), ["A"], [1.0], tolerance=0, ground_truth=truth)
    env = TechniqueSelectionEnv(bank, statistic=statistic, reward="ground_truth", allow_idle=True)
    env.reset(seed=0)
    _, reward, _, _, info = env.step([0])
    assert info["prediction"] == -1
    assert reward == 0.0
    if statistic == "belief":  # all places are as likely, so any may be the prediction
        return
    predictions = []
    for action in ([1], [0], [0], [0], [0]):
        _, reward, _, _, info = env.step(action)
        predictions.append((info["prediction"], info["reward_terms"]["correctness"]))
    assert predictions == [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.0), (4, 1.0)]


def test_a_users_own_reward(bank):
    seen = []

    def own(inputs: RewardInputs):
        seen.append(inputs.correct())
        return {
            "lateness": -inputs.outcome.routes["frame"].astype(float),
            "runs": inputs.outcome.slots["ran"].sum(axis=1) * inputs.compute_weight,
        }

    env = TechniqueSelectionEnv(bank, reward=own, compute_weight=0.25)
    _, info = env.reset(seed=0)
    assert info["reward_terms"] == {"lateness": 0.0, "runs": 0.0}
    env.step([1, 0, 0])
    _, reward, _, _, info = env.step([1, 0, 1])
    assert info["reward_terms"] == {"lateness": -1.0, "runs": 0.5}
    assert reward == -0.5
    assert seen[-1].tolist() == [abs(info["prediction"] - 1) <= 2]


@pytest.mark.parametrize("costs", ["measured", "paper", "runs"])
def test_cost_models(costs):
    bank = random_bank(1, names=["HOG", "NetVLAD", "CALC"])
    env = TechniqueSelectionEnv(bank, costs=costs)
    expected = {"measured": bank.seconds, "paper": [0.045, 0.722, 0.165], "runs": [1, 1, 1]}
    info = infos_of(env, [[0, 1, 1]])[0]
    assert info["run_seconds"].tolist() == list(expected[costs])
    assert info["seconds"] == pytest.approx(sum(expected[costs][1:]))


# ---- the compute weight ------------------------------------------------------------------


def test_compute_weight_is_drawn_on_a_logarithmic_scale(bank):
    env = TechniqueSelectionEnv(bank, compute_weight=(0.01, 10.0))
    env.reset(seed=0)
    drawn = np.array([env.reset()[1]["compute_weight"] for _ in range(400)])
    assert drawn.min() >= 0.01
    assert drawn.max() <= 10.0
    thirds = np.histogram(np.log10(drawn), bins=3, range=(-2, 1))[0]
    assert thirds.min() > 90
    position = observation_names(bank.techniques).index("route.compute_weight")
    for weight, seen in [(0.01, -1), (10**-0.5, 0), (10.0, 1), (0.0, -1), (500.0, 1)]:
        observation = env.reset(options={"compute_weight": weight})[0]
        assert observation[position] == pytest.approx(seen, abs=1e-6)


@pytest.mark.parametrize(
    "weight", [-1.0, math.nan, math.inf, (0.0, 1.0), (2.0, 1.0), (1.0, math.inf), (-1.0, 1.0)]
)
def test_wrong_compute_weights_are_refused(bank, weight):
    with pytest.raises(ValueError, match=r"compute_weight is .*; give a number"):
        TechniqueSelectionEnv(bank, compute_weight=weight)


# ---- actions -----------------------------------------------------------------------------


def test_empty_action_runs_the_cheapest(bank):
    costly_first = ScoreBank(
        bank.scores,
        bank.techniques,
        [3.0, 1.0, 1.0],
        tolerance=2,
        ground_truth=np.arange(bank.queries),
    )
    env = TechniqueSelectionEnv(costly_first)
    env.reset(seed=0)
    info = env.step([0, 0, 0])[4]
    assert info["ran"].tolist() == [False, True, False]
    assert info["fallback"]
    assert not info["idle"]
    assert info["seconds"] == 1.0
    assert not env.step([1, 0, 0])[4]["fallback"]


@pytest.mark.parametrize("statistic", STATISTICS)
def test_similarity_is_what_this_frames_row_of_the_trusted_technique_says(statistic):
    bank = random_bank(4, queries=60)
    wide = bank.scores.astype(float)  # (T, Q, R)
    z = (wide - wide.mean(axis=2, keepdims=True)) / wide.std(axis=2, keepdims=True)
    env = TechniqueSelectionEnv(bank, statistic=statistic, allow_idle=True)
    assert env.reset(seed=0, options={"start": 7})[1]["similarity"] == 0.0
    seen = []
    for frame, action in enumerate(np.random.default_rng(0).random((53, 3)) < 0.4):
        info = env.step(action)[4]
        expected = z[info["technique"], 7 + frame, info["prediction"]] if action.any() else 0.0
        assert info["similarity"] == pytest.approx(expected, abs=1e-9)
        seen.append(info["similarity"])
    assert seen.count(0.0) > 3
    assert len({round(abs(value), 6) for value in seen}) > 30


@pytest.mark.parametrize("statistic", DIAGONAL)
def test_idle_moves_on_and_decays(bank, statistic):
    env = TechniqueSelectionEnv(bank, statistic=statistic, allow_idle=True)
    last = infos_of(env, [[1, 1, 1]])[0]
    for _ in range(39):
        _, reward, _, _, info = env.step([0, 0, 0])
        assert info["idle"]
        assert not info["fallback"]
        assert info["technique"] == -1
        assert info["prediction"] == min(last["prediction"] + 1, bank.references - 1)
        assert info["confidence"] == pytest.approx(IDLE_DECAY * last["confidence"])
        assert reward == info["p_correct"] == pytest.approx(IDLE_DECAY * last["p_correct"])
        assert info["seconds"] == 0.0
        last = info
    assert not any(info["ran"])


def test_idle_moves_the_belief_on(bank):
    env = TechniqueSelectionEnv(bank, statistic="belief", allow_idle=True)
    sure = last = infos_of(env, [[1, 1, 1]] * 12)[-1]
    for _ in range(28):
        _, reward, _, _, info = env.step([0, 0, 0])
        assert info["idle"]
        assert info["technique"] == -1
        assert info["seconds"] == 0.0
        assert 0 <= info["prediction"] - last["prediction"] <= 2
        assert reward == info["p_correct"]
        assert info["p_correct"] < sure["p_correct"]
        last = info
    # It drove steadily until then, and is believed to drive on.
    assert abs(last["prediction"] - (sure["prediction"] + 28)) <= 3


@pytest.mark.parametrize("statistic", STATISTICS)
def test_idle_at_the_maps_end_stays_there(statistic):
    bank = random_bank(1, queries=30, references=30)
    env = TechniqueSelectionEnv(bank, statistic=statistic, allow_idle=True)
    infos = infos_of(env, [[1, 1, 1]] + [[0, 0, 0]] * 28, options={"start": 1})
    places = [info["prediction"] for info in infos]
    infos = infos_of(env, [[1, 1, 1]] * 25 + [[0, 0, 0]] * 4, options={"start": 1})
    places += [info["prediction"] for info in infos]
    # The belief allows for a robot that has slowed down.
    assert 29 - 3 * (statistic == "belief") <= max(places) <= 29
    scores = np.zeros((1, 4, 3))
    scores[:, :, 2] = 1.0
    end = ScoreBank(scores, ["A"], [1.0], tolerance=0, ground_truth=[2, 2, 2, 2])
    infos = infos_of(
        TechniqueSelectionEnv(end, statistic=statistic, allow_idle=True), [[1], [0], [0], [0]]
    )
    assert [info["prediction"] for info in infos] == [2, 2, 2, 2]


# ---- episodes ----------------------------------------------------------------------------


def ends_of(env, **options) -> tuple[int, bool, bool]:
    """Length of an episode, and how it ended."""
    env.reset(options=options)
    steps = 0
    while True:
        steps += 1
        _, _, terminated, truncated, _ = env.step(np.ones(env.action_space.shape))
        if terminated or truncated:
            return steps, terminated, truncated


def test_the_routes_end_terminates_and_a_length_truncates(bank):
    assert ends_of(TechniqueSelectionEnv(bank)) == (40, True, False)
    assert ends_of(TechniqueSelectionEnv(bank, episode_length=39)) == (39, False, True)
    assert ends_of(TechniqueSelectionEnv(bank, episode_length=40)) == (40, True, False)  # both
    assert ends_of(TechniqueSelectionEnv(bank, episode_length=99)) == (40, True, False)
    assert ends_of(TechniqueSelectionEnv(bank), start=30) == (10, True, False)
    limited = gym.make(ENV_NAME, bank=bank, max_episode_steps=5)
    assert ends_of(limited) == (5, False, True)


def test_random_starts_cover_the_route(bank):
    env = TechniqueSelectionEnv(bank, random_start=True, episode_length=10)
    env.reset(seed=0)
    starts = set()
    for _ in range(300):
        env.reset()
        starts.add(env.task.episodes.routes[0].start)
    assert starts == set(range(31))
    whole = TechniqueSelectionEnv(bank, random_start=True, episode_length=100)
    whole.reset(seed=0)
    assert whole.task.episodes.routes[0].start == 0


def test_a_crop_sees_the_whole_map_and_no_earlier_frame(bank):
    """Frame 0 of a crop is as the first frame of a bank that begins there."""
    cropped = ScoreBank(
        bank.scores[:, 13:],
        bank.techniques,
        bank.seconds,
        tolerance=2,
        ground_truth=np.arange(13, 40),
    )
    actions = random_actions(1, 27, (3,))
    first = infos_of(TechniqueSelectionEnv(bank), actions, options={"start": 13})
    second = infos_of(TechniqueSelectionEnv(cropped), actions)
    assert_same(first, second)


def test_ground_truth_of_a_crop_is_that_of_its_frames(bank):
    env = TechniqueSelectionEnv(bank, reward="ground_truth")
    for frame, info in enumerate(infos_of(env, np.ones((20, 3)), options={"start": 20})):
        right = abs(info["prediction"] - (20 + frame)) <= 2
        assert info["reward_terms"]["correctness"] == right


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"start": 40}, "start is 40; bank 'bank1' has 40 queries"),
        ({"start": -1}, "start is -1"),
        ({"bank": 1}, "bank 1: there are 1"),
        ({"bank": -1}, "bank -1: there are 1"),
        ({"bnak": 0}, "unknown reset option 'bnak': did you mean 'bank'"),
        ({"compute_weight": -1.0}, "compute_weight is -1.0"),
    ],
)
def test_wrong_reset_options_are_refused(bank, options, words):
    env = TechniqueSelectionEnv(bank)
    with pytest.raises(ValueError, match=words):
        env.reset(options=options)
    env.reset()
    env.step([1, 0, 0])


@pytest.mark.parametrize("statistic", STATISTICS)
def test_an_episode_knows_nothing_of_the_ones_before(bank, statistic):
    long = random_bank(8, queries=70, references=90)
    arguments = {"statistic": statistic, "reselection": 3, "allow_idle": True}
    used = TechniqueSelectionEnv([bank, long], **arguments)
    actions = random_actions(4, 40, used.action_space.shape, reselect=0.2)
    for number in (0, 1, 0):
        fresh = TechniqueSelectionEnv([bank, long], **arguments)
        episodes = []
        for env in (fresh, used):
            first = env.reset(seed=0, options={"bank": number})
            episodes.append([first, *(env.step(action) for action in actions)])
        assert_same(*episodes)


# ---- rendering ---------------------------------------------------------------------------


def test_render_says_what_happened(bank):
    env = gym.make(ENV_NAME, bank=bank, render_mode="ansi")
    env.reset(seed=0)
    _, _, _, _, info = env.step(np.array([1, 0, 1], np.int8))
    line = env.render()
    assert line == (
        f"bank1 frame 1/40: place {info['prediction']}, confidence {info['confidence']:.2f},"
        f" p {info['p_correct']:.2f}, ran T0 + T2"
    )
    assert TechniqueSelectionEnv(bank).render() is None


class Breaks:
    """A reward that fails once, on a frame."""

    def __init__(self, frame: int) -> None:
        self.frame = frame

    def __call__(self, inputs: RewardInputs) -> dict[str, Any]:
        if (inputs.outcome.routes["frame"] == self.frame).any():
            self.frame = -2
            raise RuntimeError("the reward broke")
        return {"mine": inputs.outcome.routes["p_correct"]}


@pytest.mark.parametrize("statistic", ["evidence", "belief"])
@pytest.mark.parametrize("number", [None, 3])
def test_a_route_whose_end_an_error_hid_is_not_stepped_past_it(number, statistic):
    arguments = {"bank": random_bank(1, queries=5), "statistic": statistic, "reward": Breaks(4)}
    env = (
        TechniqueSelectionEnv(**arguments)
        if number is None
        else TechniqueSelectionVectorEnv(number, **arguments)
    )
    first = env.reset(seed=0)
    everything = np.ones(env.action_space.shape)
    for _ in range(4):
        env.step(everything)
    with pytest.raises(RuntimeError, match="broke"):
        env.step(everything)
    for _ in range(3):
        with pytest.raises(ResetNeeded, match="route 0 has ended"):
            env.step(everything)
    assert_same(env.reset(seed=0), first)
    assert np.isfinite(env.step(everything)[0]).all()


def test_an_outcome_that_a_reward_keeps_stays_as_it_was():
    kept = []

    def reward(inputs: RewardInputs) -> dict[str, Any]:
        given = [*inputs.outcome, inputs.compute_weight]
        kept.append((given, [array.copy() for array in given]))
        return {"mine": inputs.outcome.routes["p_correct"]}

    banks = [random_bank(1, queries=5), random_bank(2, queries=9)]
    env = TechniqueSelectionVectorEnv(
        2, banks, reward=reward, autoreset_mode="SameStep", compute_weight=(0.1, 3.0)
    )
    env.reset(seed=0, options={"bank": np.array([0, 1])})
    ends = [env.step(np.ones((2, 3)))[2].any() for _ in range(30)]
    assert sum(ends) > 2
    for given, copies in kept:
        for array, copied in zip(given, copies, strict=True):
            assert array.tolist() == copied.tolist()


def test_what_the_docstring_says_of_prices_slots_means_and_options(bank):
    env = TechniqueSelectionEnv(bank, slots=5, compute_weight=0.7)
    assert env.action_space.shape == (5,)
    env.reset(seed=0, options={"start": 3, "compute_weight": 2.0})
    names = observation_names(tuple("abcde"))
    observation, _, _, _, info = env.step([1, 0, 0, 1, 1])  # the last two are of empty slots
    assert info["ran"].tolist() == [True, False, False, False, False]
    assert info["run_seconds"].tolist() == [*bank.seconds, 0.0, 0.0]  # prices, not what ran
    assert info["seconds"] == bank.seconds[0]
    entries = dict(zip(names, observation.tolist(), strict=True))
    mean = next(name for name in names if name.endswith("p_correct_mean"))
    assert entries[mean] == pytest.approx(0.2 * info["p_correct"], rel=1e-6)
    _, info = env.reset()
    assert (info["compute_weight"], info["frame"]) == (0.7, -1)
