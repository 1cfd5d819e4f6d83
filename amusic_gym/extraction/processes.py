"""Shards in processes of this machine.

Not `concurrent.futures.ProcessPoolExecutor`: one worker that is killed breaks its whole pool, one
killed while it sends a result blocks it for ever, and its workers outlive a killed parent.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from amusic_gym.extraction.shards import (
    ATTEMPTS,
    Advance,
    Executor,
    Held,
    S,
    Shard,
    Workers,
    nothing,
)
from amusic_gym.techniques.own_code import told

_GONE = (EOFError, OSError)  # what a pipe raises whose other end died, also in mid-message
_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass
class Processes(Executor):
    """Runs shards in ``count`` processes, which start as they are needed.

    They are spawned, so the class of what they hold must be in a module that they can import, and a
    script must start its work under ``if __name__ == "__main__":``.
    """

    count: int

    def workers(self, held: Held) -> _ProcessWorkers:
        """Processes that hold a copy; see :func:`dumped`."""
        return _ProcessWorkers(self.count, dumped(held))


def dumped(held: Held) -> bytes:
    """What workers hold, as they get it; refuses what does not pickle."""
    try:
        return pickle.dumps(held)
    except Exception as error:  # anything in a user's class
        raise ValueError(
            f"{held.name!r} does not pickle ({told(error)}); define its class "
            "at the top of a module, or use the executor 'serial'"
        ) from error


def loaded(data: bytes) -> Any:
    """What a worker holds; refuses what has a class that is not found there."""
    try:
        return pickle.loads(data)
    except (Exception, SystemExit) as error:  # whatever importing a user's module raises
        raise ValueError(
            f"a worker cannot load what it is to hold ({told(error)}); define its class in a "
            "module that workers can import, or use the executor 'serial'"
        ) from error


class _ProcessWorkers(Workers):
    def __init__(self, count: int, held: bytes) -> None:
        self._count = count
        self._held = held
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, tuple[_Worker, Any, int]] = {}  # with shard and attempt

    def run(self, shards: Iterable[S], advance: Advance = nothing) -> Iterator[tuple[S, Any]]:
        waiting = iter(shards)
        while True:
            while len(self._busy) < self._count and (shard := next(waiting, None)) is not None:
                self._give(shard, 1)
            if not self._busy:
                return
            for connection in wait(list(self._busy)):
                assert isinstance(connection, Connection)
                worker, shard, attempt = self._busy.pop(connection)
                try:
                    answer = connection.recv()
                except _GONE:
                    if attempt == ATTEMPTS:
                        raise _given_up(worker, shard) from None
                    worker.stop()
                    self._give(shard, attempt + 1)
                    continue
                self._idle.append(worker)
                if isinstance(answer, BaseException):
                    raise answer
                advance(shard.size)
                yield shard, answer

    def _give(self, shard: Shard, attempt: int) -> None:
        worker = self._idle.pop() if self._idle else _Worker(self._held)
        self._busy[worker.connection] = worker, shard, attempt
        with contextlib.suppress(*_GONE):  # it died: `run` will notice when it listens
            worker.connection.send(shard)

    def close(self) -> None:
        """End the processes, whatever they do."""
        workers = [*self._idle, *(worker for worker, _, _ in self._busy.values())]
        self._idle, self._busy = [], {}
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.stop()


def _given_up(worker: _Worker, shard: Shard) -> ChildProcessError:
    worker.process.join(1)  # its pipe closed, so it is ending: let it, for its exit code
    worker.stop()
    code = worker.process.exitcode or 0
    how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
    return ChildProcessError(
        f"{shard}: {ATTEMPTS} workers died of it, the last by {how}; if memory ran out, use "
        "fewer processes; what was finished is kept"
    )


class _Worker:
    """One process and the pipe to it."""

    def __init__(self, held: bytes) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, held), daemon=True)
        with _interrupts_held_back():
            self.process.start()
        theirs.close()

    def stop(self) -> None:
        self.connection.close()
        self.process.terminate()
        self.process.join()


@contextlib.contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Ctrl-C and its like reach this process after the block, a process started in it never."""
    resource_tracker.ensure_running()  # else the first start starts it, which lets signals in
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, data: bytes) -> None:
    """A worker's loop, until its pipe is closed."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])  # by which it is stopped
    held: Any = None
    with contextlib.suppress(*_GONE):
        while True:
            shard: Shard = connection.recv()
            answer: Any
            try:
                held = held or loaded(data)
                answer = shard.run(held)
            except Exception as error:  # whatever it is, it belongs to whoever asked
                answer = _sendable(error)
            connection.send(answer)


def _sendable(error: Exception) -> Exception:
    """``error`` if it survives pickling, else one with its text."""
    error.__cause__ = None  # not needed, and may not pickle
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError("".join(traceback.format_exception(error)))
    return error
