"""Threads that take the rows of a batch of routes into its belief, each a share of the routes.

The kernel that hears runs without the GIL. A route is heard by one thread alone, so the results are
the same for any number of threads. Kernels that write to the prepared rows of a bank hold the GIL.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from amusic_gym.estimation.belief.filter import hear_routes, look_back, prepare_rows
from amusic_gym.estimation.belief.memory import HEARING, Hearing


class Hearers:
    """What hears the frames of a batch of N routes.

    Args:
        hearing: what is read and written.
        threads: how many, no more than there are routes.
    """

    def __init__(self, hearing: Hearing, threads: int) -> None:
        routes = len(hearing.active)
        threads = min(threads, routes)
        share = np.arange(routes) * threads // routes
        self._active = hearing.active
        self._mine = np.arange(threads)[:, None] == share  # (threads, N) whose routes are whose
        self._kept = hearing  # alive, because tables know addresses only
        self._parts = [
            hearing._replace(minds=hearing.minds.beside(), active=np.zeros_like(self._active))
            for _ in range(threads if threads > 1 else 0)
        ]
        self._tables = [HEARING.write(part) for part in (hearing, *self._parts)]
        self._whole, *self._shares = [int(table.ctypes.data) for table in self._tables]

    def hear(self) -> None:
        """Take the next frame of every active route into its belief."""
        prepare_rows(self._whole)  # others who drive on the same bank share them
        if not self._parts:
            hear_routes(self._whole)
            return
        for part, mine in zip(self._parts, self._mine, strict=True):
            np.logical_and(self._active, mine, out=part.active)
        left = deque(self._shares)
        waiting: list[Future[None]] = []
        try:
            try:
                for _ in self._shares[1:]:
                    waiting.append(_executor().submit(self._hear_some, left))
            except RuntimeError:  # the interpreter is about to end and starts no more threads
                pass
            self._hear_some(left)
        finally:  # nobody may write to what an interrupted step leaves behind
            _wait_for(waiting)

    def _hear_some(self, left: deque[int]) -> None:
        """Hear shares, given by their addresses, as long as there are any left."""
        while left:
            try:
                address = left.pop()
            except IndexError:  # another thread was faster
                return
            hear_routes(address)

    def look_back(self) -> None:
        """Run all techniques on the last frames of the routes that want it, after the fact."""
        look_back(self._whole)


def _wait_for(futures: Iterable[Future[None]]) -> None:
    """Wait until all are done, whatever interrupts it; then let the interrupt through."""
    interrupt: KeyboardInterrupt | None = None
    for future in futures:
        while not future.done():
            try:
                future.exception()
            except KeyboardInterrupt as error:
                interrupt = error
    if interrupt is not None:
        raise interrupt


_executors: list[ThreadPoolExecutor] = []  # none or the one of this process


def _executor() -> ThreadPoolExecutor:
    if not _executors:
        _executors.append(ThreadPoolExecutor(max_workers=os.cpu_count()))
    return _executors[0]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_executors.clear)  # its threads are the parent's
