"""Where routes come from: one bank, several, of any size, on disk, simulated."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from env_cases import assert_same, infos_of, play, random_actions, random_bank
from stable_baselines3.common.env_util import make_vec_env

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.observation import TECHNIQUE_FEATURES, observation_names
from amusic_gym.envs.sources import Banks, RouteSource, SimulatedRoutes
from amusic_gym.routes.simulate import TOURS, TOURS_IN_MOTION

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
    with pytest.raises(ValueError, match=r"'odd one' has the techniques .*slots=S"):
        TechniqueSelectionEnv([bank, other])
    with pytest.raises(ValueError, match=r" has the techniques .*slots=S"):
        TechniqueSelectionEnv([other, bank])  # before any reset, whichever comes first


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"bank": 5}, "bank is 5; give a folder"),
        ({"costs": "papr"}, "unknown cost model 'papr': did you mean 'paper'"),
        ({"costs": "paper"}, "simulated routes have their own"),
        ({"allow_idle": "no"}, "allow_idle is 'no'; give True or False"),
        ({"random_start": 1}, "random_start is 1; give True or False"),
        ({"coverage": "a"}, "coverage .* is 'a'; give a number"),
        ({"gamma": "a"}, "gamma is 'a'; give a number"),
        ({"compute_weight": (1, 2, 3)}, "compute_weight is .*; give a number"),
        ({"compute_weight": True}, "compute_weight is True; give a number"),
        ({"reward": lambda inputs: 1.0}, "the reward gave 1.0; let it return named terms"),
    ],
)
def test_arguments_of_the_wrong_kind_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        TechniqueSelectionEnv(**arguments).reset(seed=0)


def test_routes_outside_the_pool_are_refused():
    env = TechniqueSelectionEnv(SimulatedRoutes(pool=3))
    for number in (3, -1):
        with pytest.raises(ValueError, match=f"route {number}: there are 3, numbered from 0"):
            env.reset(options={"bank": number})


def test_idling_at_the_end_of_the_map_does_not_continue():
    scores = np.zeros((1, 4, 1))
    bank = ScoreBank(scores, ["A"], [1.0], tolerance=0, ground_truth=np.zeros(4, np.int64))
    env = TechniqueSelectionEnv(bank, allow_idle=True)
    env.reset(seed=0)
    env.step([1])
    observation, *_, info = env.step([0])
    assert info["prediction"] == 0  # the only place
    assert observation[observation_names(bank.techniques).index("route.continues")] == 0.0


def test_stable_baselines3_makes_the_environment_by_name():
    routes = make_vec_env("amusic_gym:amusic_gym/TechniqueSelection-v0", n_envs=2)
    assert routes.reset().shape[0] == 2
    assert routes.render_mode == "rgb_array"  # which it asks of every environment


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


@pytest.mark.parametrize(
    ("statistic", "population"), [("evidence", TOURS), ("mean", TOURS), ("belief", TOURS_IN_MOTION)]
)
def test_without_a_bank_the_routes_are_those_of_the_statistic(statistic, population):
    env = TechniqueSelectionEnv(statistic=statistic)
    assert env.task.source.simulation == replace(population, techniques=(4, 4))
    assert env.action_space.shape == (4,)


def test_without_a_simulation_the_routes_are_those_of_the_default_statistic():
    assert SimulatedRoutes().simulation == TechniqueSelectionEnv().task.source.simulation
    assert TechniqueSelectionEnv().task.settings.statistic == "evidence"


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


def test_a_drawn_route_is_let_go_when_its_episode_is_over():
    env = TechniqueSelectionEnv()
    _, info = env.reset(seed=0)
    first = weakref.ref(env.task.episodes.routes[0].bank)
    asked = env.reset(options={"bank": 7}) and weakref.ref(env.task.episodes.routes[0].bank)
    env.reset()
    gc.collect()
    assert first() is None
    assert asked() is not None
    assert env.reset(seed=0)[1]["route"] == info["route"]


def test_given_banks_are_a_source_of_routes(bank):
    assert isinstance(Banks([bank]), RouteSource)
    assert TechniqueSelectionEnv(Banks([bank])).reset(seed=0)[1]["route"] == 0
