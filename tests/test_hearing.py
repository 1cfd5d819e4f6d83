"""Threads that share a batch's belief give the bits of one thread."""

from __future__ import annotations

import copy
import multiprocessing
import pickle

import numpy as np
import pytest
from env_cases import assert_same, random_actions, random_bank

from amusic_gym.belief.filter import prepare_rows
from amusic_gym.vector_env import TechniqueSelectionVectorEnv

BANKS = [random_bank(1), random_bank(2, queries=7, references=90), random_bank(3, queries=25)]


def make(threads: int, number: int = 5, **arguments) -> TechniqueSelectionVectorEnv:
    arguments = {"bank": BANKS, "statistic": "belief", **arguments}
    return TechniqueSelectionVectorEnv(number, threads=threads, **arguments)


def steps(env: TechniqueSelectionVectorEnv, count: int, seed: int = 0) -> list[object]:
    return [env.step(a) for a in random_actions(seed, count, env.action_space.shape)]


@pytest.mark.parametrize("threads", [2, 3, 5, 50])
@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"reselection": 3, "allow_idle": True},
        {"autoreset_mode": "SameStep", "random_start": True},
        {"bank": BANKS[0]},
    ],
)
def test_any_number_of_threads_gives_the_same_bits(threads, arguments):
    one, several = make(1, **arguments), make(threads, **arguments)
    assert_same(one.reset(seed=4), several.reset(seed=4))
    assert_same(steps(one, 60), steps(several, 60))


def test_routes_that_share_unprepared_rows_do_not_disturb_each_other():
    def fresh() -> object:
        return random_bank(8, queries=30, references=3000)

    for _ in range(5):
        one, several = make(1, 16, bank=fresh()), make(4, 16, bank=fresh())
        assert_same(one.reset(seed=1), several.reset(seed=1))
        assert_same(steps(one, 29), steps(several, 29))


@pytest.mark.parametrize("twin_of", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_in_mid_episode_goes_on_the_same(twin_of):
    env = make(2)
    env.reset(seed=2)
    steps(env, 9)
    twin = twin_of(env)
    assert_same(steps(env, 30, 1), steps(twin, 30, 1))


def test_rows_are_prepared_before_the_threads_begin(monkeypatch):
    seen: list[int] = []

    def first(address: int) -> None:
        seen.append(address)
        prepare_rows(address)

    monkeypatch.setattr("amusic_gym.belief.hearing.prepare_rows", first)
    for threads, count in ((1, 0), (2, 4)):
        env = make(threads)
        env.reset(seed=0)
        steps(env, 4)
        assert len(seen) == count


@pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="this system has no fork"
)
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    env = make(2)
    env.reset(seed=0)
    steps(env, 3)
    context = multiprocessing.get_context("fork")
    results = context.SimpleQueue()
    child = context.Process(target=lambda: results.put(steps(env, 5, 1)), daemon=True)
    child.start()
    child.join(60)
    assert child.exitcode == 0
    assert_same(results.get(), steps(env, 5, 1))


@pytest.mark.parametrize("threads", [0, -1, 1.5, "two", None])
def test_other_numbers_of_threads_are_refused(threads):
    with pytest.raises(ValueError, match="threads is"):
        make(threads)


def test_one_route_has_one_thread():
    env = make(4, 1)
    assert_same(env.reset(seed=0), make(1, 1).reset(seed=0))
    assert np.isfinite(env.step([[1, 0, 0]])[1]).all()
