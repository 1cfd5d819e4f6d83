"""Executors run shards somewhere; one thread is what makes their results the same."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
import threadpoolctl
from extraction_cases import Shard, Tiny, UnpicklableError

from amusic_gym.extraction.executors import Serial, make_executor
from amusic_gym.extraction.processes import Processes
from amusic_gym.utils import threads
from amusic_gym.utils.threads import alone, one_thread

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent


class Unpicklable(Tiny):
    def __init__(self):
        super().__init__()
        self.hook = lambda: None


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpoolctl.threadpool_info()}


@pytest.mark.parametrize("executor", [Serial(), Processes(2)], ids=["serial", "process"])
def test_every_shard_is_run_once(executor):
    with executor, executor.workers(Tiny(power=0.5)) as workers:
        for count in (0, 1, 9):
            results = list(workers.run(Shard(number) for number in range(count)))
            assert sorted(shard.number for shard, _ in results) == list(range(count))
            for shard, result in results:
                assert result.tolist() == [shard.number / 2] * 2


def test_shards_are_taken_as_workers_become_free():
    taken = []

    def shards():
        for number in range(20):
            taken.append(number)
            yield Shard(number)

    with Processes(2).workers(Tiny()) as workers:
        next(workers.run(shards()))
        assert len(taken) <= 3


def test_processes_start_only_when_there_is_work():
    with Processes(64).workers(Tiny()) as workers:
        assert list(workers.run([])) == []
        list(workers.run([Shard(1)]))
        assert len(workers._idle) == 1


def test_workers_are_gone_in_the_end():
    with Processes(2).workers(Tiny()) as workers:
        list(workers.run([Shard(1), Shard(2)]))
        processes = [worker.process for worker in workers._idle]
    assert not any(process.is_alive() for process in processes)


INTERRUPTED = """
import os, signal
from extraction_cases import Shard, Tiny
from amusic_gym.extraction.processes import Processes
with Processes(2).workers(Tiny()) as workers:
    list(workers.run([Shard(1), Shard(2)]))
    before = [worker.process.pid for worker in workers._idle]
    for pid in before:
        os.kill(pid, signal.SIGINT)
    assert len(list(workers.run([Shard(1), Shard(2)]))) == 2
    assert {worker.process.pid for worker in workers._idle} == set(before)
"""


def test_ctrl_c_does_not_reach_workers():
    paths = [str(folder) for folder in (ROOT, ROOT / "tests/support")]
    done = subprocess.run(  # of its own: the very first worker of a process is a special case
        [sys.executable, "-W", "error", "-c", INTERRUPTED],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_an_error_in_a_shard_is_raised_as_it_is():
    with Processes(1).workers(Tiny()) as workers:
        with pytest.raises(ValueError, match=r"^img\.png is broken$"):
            list(workers.run([Shard(1, (ValueError, "img.png is broken"))]))
        assert len(list(workers.run([Shard(2)]))) == 1  # the worker lives on
        with pytest.raises(RuntimeError, match="UnpicklableError: first"):
            list(workers.run([Shard(1, (UnpicklableError, "first", "second"))]))


def test_a_technique_that_does_not_pickle_is_refused_at_once():
    with pytest.raises(ValueError, match="does not pickle .* top of a module"):
        Processes(1).workers(Unpicklable())


def test_a_technique_that_workers_do_not_find_is_refused(monkeypatch):
    monkeypatch.setitem(Tiny.__init__.__globals__, "Hidden", None)
    hidden = type("Hidden", (Tiny,), {"__module__": Tiny.__module__, "__qualname__": "Hidden"})
    sys.modules[Tiny.__module__].Hidden = hidden
    technique = hidden()
    assert pickle.dumps(technique)
    with (
        Processes(1).workers(technique) as workers,
        pytest.raises(ValueError, match="cannot load what it is to hold .* executor 'serial'"),
    ):
        list(workers.run([Shard(1)]))


@pytest.mark.parametrize(
    "name", ["", "serial:", "serial:2", "process", "process:", "process:x", "ray:", "rya", "3"]
)
def test_unknown_executors_are_refused(name):
    with pytest.raises(ValueError, match=r"unknown executor .* valid: serial, process:N, ray"):
        make_executor(name)


def test_no_process_is_refused():
    with pytest.raises(ValueError, match="executor 'process:0' has no process; give at least 1"):
        make_executor("process:0")


@pytest.mark.parametrize("executor", [Serial(), Processes(1)])
def test_all_work_that_is_done_is_told(executor):
    told = []
    with executor, executor.workers(Tiny()) as workers:
        list(workers.run([Shard(1, size=3), Shard(2, size=4)], told.append))
    assert sorted(told) == [3, 4]


def test_the_nearest_executor_is_suggested():
    with pytest.raises(ValueError, match="did you mean 'process:N'"):
        make_executor("proces:2")


# ---- one thread ------------------------------------------------------------------------------


@pytest.fixture
def two_threads():
    """Libraries that may use two threads, whatever the tests' environment says."""
    np.ones((2, 2)) @ np.ones((2, 2))
    before = cv2.getNumThreads()
    with threadpoolctl.threadpool_limits(2):
        cv2.setNumThreads(2)
        yield
    cv2.setNumThreads(before)


@pytest.mark.usefixtures("two_threads")
def test_libraries_use_one_thread_and_get_theirs_back():
    assert 2 in blas_threads()
    with one_thread():
        assert (blas_threads(), cv2.getNumThreads()) == ({1}, 1)
        with one_thread():
            pass
        assert (blas_threads(), cv2.getNumThreads()) == ({1}, 1)
    assert 2 in blas_threads()
    assert cv2.getNumThreads() == 2


@pytest.mark.usefixtures("two_threads")
def test_what_was_comes_back_when_the_last_python_thread_leaves():
    inside, leave = threading.Event(), threading.Event()

    def stay():
        with one_thread():
            inside.set()
            leave.wait()

    other = threading.Thread(target=stay)
    with one_thread():
        other.start()
        inside.wait()
    assert cv2.getNumThreads() == 1
    leave.set()
    other.join()
    assert cv2.getNumThreads() == 2


@pytest.mark.usefixtures("two_threads")
def test_a_call_that_loads_a_library_is_made_again_on_one_thread(monkeypatch):
    seen = []
    absent = sys.modules["cv2"]
    monkeypatch.delitem(sys.modules, "cv2")

    def load_late():
        sys.modules["cv2"] = absent
        seen.append(cv2.getNumThreads())
        return seen[-1]

    assert alone(load_late) == 1
    assert seen == [2, 1]
    assert cv2.getNumThreads() == 2
    assert alone(load_late) == 1
    assert seen == [2, 1, 1]


def test_limits_look_for_libraries_only_when_modules_were_loaded(monkeypatch):
    with one_thread():
        pass
    monkeypatch.setattr(threads._limits, "known_at", len(sys.modules))
    monkeypatch.setattr(threadpoolctl, "ThreadpoolController", None)
    with one_thread():
        pass
