"""Threads that share a batch's belief give the bits of one thread."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from env_cases import assert_same, random_actions, random_bank

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.belief.filter import filter_routes, prepare_rows

pytestmark = pytest.mark.slow

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

    monkeypatch.setattr("amusic_gym.estimation.belief.estimator.prepare_rows", first)
    for threads in (1, 2):
        env = make(threads)
        env.reset(seed=0)
        steps(env, 4)
        assert len(seen) == 4 * threads


def test_environments_in_several_python_threads_may_share_a_bank():
    rising = np.arange(20_000.0)  # every place is better than those before: ranking takes long
    scores = np.tile(rising, (2, 6, 1))
    for _ in range(4):
        bank = ScoreBank(
            scores, ["A", "B"], [1.0, 2.0], tolerance=1, ground_truth=np.arange(scores.shape[1])
        )
        envs = [make(1, 2, bank=bank) for _ in range(4)]
        started = threading.Barrier(len(envs))

        def drive(env: TechniqueSelectionVectorEnv, started: threading.Barrier = started) -> None:
            env.reset(seed=1)
            started.wait()
            for _ in range(6):
                env.step(np.ones((2, 2)))

        with ThreadPoolExecutor(4) as pool:
            list(pool.map(drive, envs))
        top = bank.prepared(envs[0].task.settings.candidates).top
        assert (top == 19_999 - np.arange(top.shape[-1])).all()


def test_an_interrupt_waits_for_the_other_threads(monkeypatch):
    written = []

    def slow(address: int) -> None:
        if threading.current_thread() is threading.main_thread():
            raise KeyboardInterrupt
        time.sleep(0.3)
        filter_routes(address)
        written.append(time.monotonic())

    env = make(2)
    env.reset(seed=0)
    monkeypatch.setattr("amusic_gym.estimation.belief.estimator.filter_routes", slow)
    with pytest.raises(KeyboardInterrupt):
        env.step(np.ones((5, 3)))
    interrupted = time.monotonic()
    assert written
    assert max(written) < interrupted


def test_without_further_threads_this_one_does_it_all(monkeypatch):
    class Ended:
        def submit(self, *given: object) -> None:
            raise RuntimeError("cannot schedule new futures after interpreter shutdown")

    monkeypatch.setattr("amusic_gym.estimation.belief.estimator._executor", Ended)
    one, several = make(1), make(3)
    assert_same(one.reset(seed=4), several.reset(seed=4))
    assert_same(steps(one, 20), steps(several, 20))


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
