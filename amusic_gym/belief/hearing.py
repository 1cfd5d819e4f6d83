"""Threads that take the rows of a batch of routes into its belief, each a share of the routes.

The kernels run without the GIL. A route is heard by one thread alone, so that the results are the
same for any number of threads.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from amusic_gym.belief.filter import hear_routes, look_back, prepare_rows
from amusic_gym.belief.memory import HEARING, Hearing


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
        self._parts = [hearing]  # the first thread's memory of what others share is the batch's
        for _ in range(threads - 1):
            self._parts.append(hearing._replace(minds=hearing.minds.beside()))
        if threads > 1:
            self._parts = [
                part._replace(active=np.zeros_like(self._active)) for part in self._parts
            ]
        self._tables = [HEARING.write(part) for part in (hearing, *self._parts)]
        self._whole, *self._addresses = [int(table.ctypes.data) for table in self._tables]

    def hear(self) -> None:
        """Take the next frame of every active route into its belief."""
        if len(self._parts) == 1:
            hear_routes(self._whole)
            return
        prepare_rows(self._whole)  # routes share them
        for part, mine in zip(self._parts, self._mine, strict=True):
            np.logical_and(self._active, mine, out=part.active)
        first, *others = self._addresses
        waiting = [_executor().submit(hear_routes, address) for address in others]
        hear_routes(first)
        for other in waiting:
            other.result()

    def look_back(self) -> None:
        """Run all techniques on the last frames of the routes that want it, after the fact."""
        look_back(self._whole)


_executors: list[ThreadPoolExecutor] = []  # none or the one of this process


def _executor() -> ThreadPoolExecutor:
    if not _executors:
        _executors.append(ThreadPoolExecutor(max_workers=os.cpu_count()))
    return _executors[0]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_executors.clear)  # its threads are the parent's
