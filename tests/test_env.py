"""The single environment: contracts, spaces, observation, rewards, infos, episodes, banks."""

from __future__ import annotations

import doctest
import math
import re
from collections import defaultdict

import gymnasium as gym
import numpy as np
import oracle
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
from gymnasium.utils.env_checker import check_env

from amusic_gym import env as env_module
from amusic_gym.bank import ScoreBank
from amusic_gym.env import TechniqueSelectionEnv
from amusic_gym.observation import (
    ROUTE_FEATURES,
    SMOOTHING,
    TECHNIQUE_FEATURES,
    observation_names,
    observation_size,
)
from amusic_gym.rewards import RewardInputs
from amusic_gym.settings import STATISTICS
from amusic_gym.sources import Banks, RouteSource, SimulatedRoutes

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
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(f"amusic_gym:{name}", **arguments).unwrapped)


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


# ---- the observation ---------------------------------------------------------------------


def documented(heading: str) -> list[str]:
    """Names in one of the docstring's tables, in order."""
    table = TechniqueSelectionEnv.__doc__.split(f"| {heading} | meaning |")[1].split("\n\n")[0]
    return re.findall(r"^ *\| (\w+) \|", table, re.MULTILINE)


def test_layout_is_the_documented_one(bank):
    assert tuple(documented("per technique")) == TECHNIQUE_FEATURES
    assert tuple(documented("route")) == ROUTE_FEATURES
    names = observation_names(bank.techniques)
    assert len(names) == len(set(names)) == observation_size(3)
    assert TechniqueSelectionEnv(bank).reset(seed=0)[0].shape == (len(names),)
    assert names[0] == "T0.present"
    assert names[len(TECHNIQUE_FEATURES)] == "T1.present"
    assert names[-1] == "route.agreeing"


def squash(value: float) -> float:
    return max(-1.0, min(1.0, math.asinh(value) / 8))


class Observer:
    """The documented observation, worked out from the infos and the explicit loops of SIC."""

    def __init__(self, bank: ScoreBank, statistic: str, block: int, weight: float) -> None:
        self.bank, self.statistic, self.block, self.weight = bank, statistic, block, weight
        self.width = len(bank.techniques)
        self.z = oracle.standardise_bank(bank.scores)
        self.exists = np.zeros((bank.queries, self.width), bool)
        self.slots: list[dict] = [defaultdict(float, last=-1) for _ in range(self.width)]
        self.route: dict = defaultdict(float, prediction=-1)

    def run(self, t: int, frame: int) -> None:
        """Remember a technique's corrected match on a frame."""
        own = self.exists[:, t]
        sic = oracle.sic(self.bank.scores[t], own, frame, statistic=self.statistic, z=self.z[t])
        alone = oracle.Music(0, sic.place, sic.statistic, [sic])
        margin = oracle.margin(alone, self.bank.tolerance) or 0.0
        self.slots[t].update(place=sic.place, statistic=sic.statistic, margin=margin, last=frame)
        self.slots[t]["correction"] = sic.correction

    def note(self, frame: int, info: dict) -> None:
        """Take in what a step's infos say."""
        route, before = self.route, self.route["prediction"]
        late = info["selection"]["happened"]
        if late:
            self.exists[max(0, frame - self.block) : frame] = True
        self.exists[frame] = info["ran"]
        for t in range(self.width):
            if late:
                self.run(t, frame - 1)
            if info["ran"][t]:
                self.run(t, frame)
        route["prediction"] = info["prediction"]
        moved = before >= 0 and info["prediction"] == before + 1
        route["continues"] = float(moved or (info["idle"] and before >= 0))
        route["since_doubt"] = 0.0 if info["p_correct"] < 0.5 else route["since_doubt"] + 1
        route["p_mean"] += SMOOTHING * (info["p_correct"] - route["p_mean"])
        route["compute"] = info["seconds"] / self.bank.seconds.sum()
        route["compute_mean"] += SMOOTHING * (route["compute"] - route["compute_mean"])
        self.relate(frame, info)

    def relate(self, frame: int, info: dict) -> None:
        """Compare every technique's last match with the fused prediction."""
        agreeing = 0.0
        for t, slot in enumerate(self.slots):
            if slot["last"] < 0 or info["prediction"] < 0:
                continue
            age = frame - slot["last"]
            there = info["prediction"] - age
            near = abs(slot["place"] + age - info["prediction"]) <= self.bank.tolerance
            slot["agrees"] = float(near)
            agreeing += near
            known = (self.z[t], self.exists[:, t], slot["last"], there, 1000, 1.0)
            slot["stored"] = oracle.diagonal_statistic(*known, self.statistic) if there >= 0 else 0
            if info["ran"][t]:
                slot["support"] = self.z[t][frame][info["prediction"]]
                slot["support_mean"] += SMOOTHING * (slot["support"] - slot["support_mean"])
                slot["agreement"] += SMOOTHING * (near - slot["agreement"])
        self.route["agreeing"] = agreeing / self.width

    def technique_group(self, t: int, frame: int, info: dict) -> list[float]:
        slot, share = self.slots[t], self.bank.seconds[t] / self.bank.seconds.sum()
        return [
            1.0,
            float(info["ran"][t]),
            squash(slot["statistic"]),
            squash(slot["margin"]),
            squash(slot["correction"]),
            slot["agrees"],
            slot["agreement"],
            squash(slot["support"]),
            squash(slot["support_mean"]),
            squash(slot["stored"]),
            squash(frame - slot["last"]) if slot["last"] >= 0 else 1.0,
            float(info["technique"] == t),
            share,
            max(-1.0, 1 + math.log10(share) / 4),
            squash(self.weight * share),
        ]

    def route_group(self, frame: int, info: dict) -> list[float]:
        route = self.route
        weight = -1 + 2 * (math.log10(self.weight) + 2) / 3
        return [
            max(-1.0, min(1.0, weight)),
            float(info["prediction"] >= 0),
            squash(info["confidence"]),
            squash(info["margin"]),
            info["p_correct"],
            route["p_mean"],
            route["continues"],
            squash(route["since_doubt"]),
            squash(frame + 1),
            squash(route["compute"]),
            squash(route["compute_mean"]),
            route["agreeing"],
        ]

    def expected(self, frame: int, info: dict) -> list[float]:
        groups = [self.technique_group(t, frame, info) for t in range(self.width)]
        return sum(groups, []) + self.route_group(frame, info)


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("weight", [0.001, 0.4, 30.0])
def test_observation_means_what_the_table_says(bank, statistic, weight):
    env = TechniqueSelectionEnv(
        bank, statistic=statistic, reselection=4, allow_idle=True, compute_weight=weight
    )
    observer = Observer(bank, statistic, 4, weight)
    observation, info = env.reset(seed=0)
    names = observation_names(bank.techniques)
    actions = random_actions(3, 40, (4,), reselect=0.15)
    actions[:2] = 0  # idle before there is any prediction
    for frame, action in enumerate([None, *actions], start=-1):
        if action is not None:
            observation, _, _, _, info = env.step(action)
            observer.note(frame, info)
        expected = dict(zip(names, observer.expected(frame, info), strict=True))
        found = dict(zip(names, observation.tolist(), strict=True))
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-6), f"frame {frame}"


def test_a_first_prediction_continues_nothing():
    scores = np.zeros((1, 4, 4)) + np.eye(4)
    bank = ScoreBank(scores, ["A"], [1.0], tolerance=0)
    env = TechniqueSelectionEnv(bank)
    env.reset(seed=0)
    position = observation_names(bank.techniques).index("route.continues")
    steps = [env.step([1]) for _ in range(4)]
    assert [step[4]["prediction"] for step in steps] == [0, 1, 2, 3]
    assert [step[0][position] for step in steps] == [0.0, 1.0, 1.0, 1.0]


def test_observation_holds_nothing_of_techniques_that_did_not_run(bank):
    """Other scores of a technique that never runs change nothing; nor does the ground truth."""
    scores = np.array(bank.scores)
    scores[2] = np.random.default_rng(0).normal(size=scores[2].shape)
    truth = np.random.default_rng(1).integers(0, 60, 40)
    other = ScoreBank(
        scores, bank.techniques, bank.seconds, tolerance=2, ground_truth=truth, name=bank.name
    )
    actions = random_actions(0, 30, (3,))
    actions[:, 2] = 0
    both = [play(TechniqueSelectionEnv(b, compute_weight=0.2), actions) for b in (bank, other)]
    assert_same(*both)


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


def test_no_prediction_is_wrong():
    truth = np.zeros((6, 5), bool)
    truth[:, -1] = True  # truth[q, -1] must not be read
    bank = ScoreBank(np.zeros((1, 6, 5)), ["A"], [1.0], tolerance=0, ground_truth=truth)
    env = TechniqueSelectionEnv(bank, reward="ground_truth", allow_idle=True)
    env.reset(seed=0)
    _, reward, _, _, info = env.step([0])
    assert info["prediction"] == -1
    assert reward == 0.0
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
    costly_first = ScoreBank(bank.scores, bank.techniques, [3.0, 1.0, 1.0], tolerance=2)
    env = TechniqueSelectionEnv(costly_first)
    env.reset(seed=0)
    info = env.step([0, 0, 0])[4]
    assert info["ran"].tolist() == [False, True, False]
    assert info["fallback"]
    assert not info["idle"]
    assert info["seconds"] == 1.0
    assert not env.step([1, 0, 0])[4]["fallback"]


def test_idle_moves_on_and_decays(bank):
    env = TechniqueSelectionEnv(bank, allow_idle=True)
    last = infos_of(env, [[1, 1, 1]])[0]
    for _ in range(39):
        _, reward, _, _, info = env.step([0, 0, 0])
        assert info["idle"]
        assert not info["fallback"]
        assert info["technique"] == -1
        assert info["prediction"] == min(last["prediction"] + 1, bank.references - 1)
        assert info["confidence"] == pytest.approx(0.9 * last["confidence"])
        assert reward == info["p_correct"] == pytest.approx(0.9 * last["p_correct"])
        assert info["seconds"] == 0.0
        last = info
    assert not any(info["ran"])


def test_idle_at_the_maps_end_stays_there():
    bank = random_bank(1, queries=30, references=30)
    env = TechniqueSelectionEnv(bank, allow_idle=True)
    infos = infos_of(env, [[1, 1, 1]] + [[0, 0, 0]] * 28, options={"start": 1})
    places = [info["prediction"] for info in infos]
    infos = infos_of(env, [[1, 1, 1]] * 25 + [[0, 0, 0]] * 4, options={"start": 1})
    places += [info["prediction"] for info in infos]
    assert max(places) == 29
    scores = np.zeros((1, 4, 3))
    scores[:, :, 2] = 1.0
    end = ScoreBank(scores, ["A"], [1.0], tolerance=0, ground_truth=[2, 2, 2, 2])
    infos = infos_of(TechniqueSelectionEnv(end, allow_idle=True), [[1], [0], [0], [0]])
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


# ---- several banks -----------------------------------------------------------------------


def test_banks_are_drawn_with_the_environments_own_generator():
    env = TechniqueSelectionEnv([random_bank(i) for i in range(3)])
    env.reset(seed=0)
    drawn = [env.reset()[1]["route"] for _ in range(200)]
    assert min(np.bincount(drawn, minlength=3)) > 40
    env.reset(seed=0)
    assert [env.reset()[1]["route"] for _ in range(200)] == drawn


def test_banks_are_aligned_by_name(bank):
    shuffled = bank.subset(["T2", "T0", "T1"])
    env = TechniqueSelectionEnv([bank, shuffled])
    actions = random_actions(0, 40, (3,))
    first = infos_of(env, actions, options={"bank": 0})
    second = infos_of(env, actions, options={"bank": 1})
    for a, b in zip(first, second, strict=True):
        assert_same({**a, "route": 0}, {**b, "route": 0})


@pytest.mark.parametrize("names", [["T0", "T1"], ["T0", "T1", "X"], ["T0", "T1", "T2", "T3"]])
def test_banks_of_other_techniques_are_refused(bank, names):
    other = random_bank(2, techniques=len(names), names=names, name="odd one")
    env = TechniqueSelectionEnv([bank, other])
    with pytest.raises(ValueError, match=r"'odd one' has the techniques .*slots=S"):
        env.reset(options={"bank": 1})


def test_slots_take_banks_of_any_size(bank):
    """Bits of empty slots are ignored at no cost; the rest is as without them."""
    banks = [bank, random_bank(2, techniques=1, queries=20, references=33), random_bank(3, 5)]
    env = TechniqueSelectionEnv(banks, slots=7, reselection=4)
    per = len(TECHNIQUE_FEATURES)
    for number, single in enumerate(banks):
        width = len(single.techniques)
        alone = TechniqueSelectionEnv(single, reselection=4)
        alone.reset(seed=0)
        env.reset(seed=0, options={"bank": number})
        for action in random_actions(number, single.queries, (8,), reselect=0.15):
            found = env.step(action)
            expected = alone.step(np.append(action[:width], action[-1]))
            groups = found[0][: 7 * per].reshape(7, per)
            assert groups[:, 0].tolist() == [1.0] * width + [0.0] * (7 - width)
            assert not groups[width:].any()
            assert_same(np.append(groups[:width], found[0][7 * per :]), expected[0])
            assert found[1:4] == expected[1:4]
            assert found[4]["seconds"] == expected[4]["seconds"]
            assert not found[4]["ran"][width:].any()
            assert found[4]["present"].tolist() == [True] * width + [False] * (7 - width)


def test_too_few_slots_are_refused(bank):
    with pytest.raises(ValueError, match="slots is 2; give a whole number >= 3"):
        TechniqueSelectionEnv(bank, slots=2)


@pytest.mark.parametrize("banks", [[], ()])
def test_no_bank_is_refused(banks):
    with pytest.raises(ValueError, match="no score bank given"):
        TechniqueSelectionEnv(banks)


def test_a_bank_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        TechniqueSelectionEnv(tmp_path / "nowhere")


def test_banks_from_disk_are_as_in_memory(bank, tmp_path):
    path = bank.save(tmp_path / "bank1")
    actions = random_actions(0, 50, (3,))
    first = play(TechniqueSelectionEnv(bank), actions)
    assert_same(first, play(TechniqueSelectionEnv(path), actions))
    assert_same(first, play(TechniqueSelectionEnv(str(path)), actions))
    assert_same(first, play(TechniqueSelectionEnv([ScoreBank.load(path)]), actions))


@pytest.mark.parametrize("width", [1, 2, 16])
def test_any_number_of_techniques(width):
    env = TechniqueSelectionEnv(random_bank(1, techniques=width), reselection=5)
    actions = random_actions(2, 60, (width + 1,))
    for returned in play(env, actions):
        assert env.observation_space.contains(returned[0])


# ---- simulated routes --------------------------------------------------------------------


def test_simulated_routes_are_endless_or_a_pool():
    endless = TechniqueSelectionEnv()
    endless.reset(seed=0)
    assert len({endless.reset()[1]["route"] for _ in range(20)}) == 20
    pool = SimulatedRoutes(pool=3)
    assert isinstance(pool, RouteSource)
    env = TechniqueSelectionEnv(pool)
    env.reset(seed=0)
    assert {env.reset()[1]["route"] for _ in range(40)} == {0, 1, 2}


def test_pools_of_other_seeds_hold_other_routes():
    rng = np.random.default_rng(0)
    first, second = (SimulatedRoutes(pool=1, seed=seed).sample(rng, 0)[0] for seed in (0, 1))
    assert first.shape != second.shape or not np.array_equal(first.scores, second.scores)
    with pytest.raises(ValueError, match="pool is 0"):
        SimulatedRoutes(pool=0)


def test_routes_that_were_let_go_come_back_the_same():
    source = SimulatedRoutes(pool=4, keep=1)
    env, kept = TechniqueSelectionEnv(source), TechniqueSelectionEnv(SimulatedRoutes(pool=4))
    actions = random_actions(0, 25, (4,))
    for number in (0, 1, 2, 0):
        both = [infos_of(e, actions, options={"bank": number}) for e in (env, kept)]
        assert_same(*both)


def test_given_banks_are_a_source_of_routes(bank):
    assert isinstance(Banks([bank]), RouteSource)
    assert TechniqueSelectionEnv(Banks([bank])).reset(seed=0)[1]["route"] == 0


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
