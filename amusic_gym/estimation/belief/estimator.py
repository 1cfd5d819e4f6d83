"""The belief as an estimator; threads share its routes.

The kernel that filters runs without the GIL. A route is filtered by one thread alone, so the
results are the same for any number of threads. Kernels that write to the prepared rows of a bank
hold the GIL.
"""

from __future__ import annotations

import copy
import os
from collections import deque
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.belief.filter import (
    filter_routes,
    look_back,
    prepare_rows,
    update_routes,
)
from amusic_gym.estimation.belief.model import MODES, REACH, REACH_BACK
from amusic_gym.estimation.belief.state import BeliefState, begin
from amusic_gym.estimation.calibration import coefficients
from amusic_gym.estimation.settings import SICSettings


class BeliefEstimator:
    """See :class:`~amusic_gym.estimation.estimator.Estimator`.

    Args:
        settings: the statistic is ``belief``.
        block: M, 0 without re-selection.
        threads: that share the routes; no more than there are.
    """

    state: BeliefState

    def __init__(self, settings: SICSettings, *, block: int, threads: int = 1) -> None:
        self.settings = settings
        self._block = block
        self._threads = threads

    def allocate(self, batch: Batch, sizes: Mapping[str, int]) -> None:
        """Make room."""
        calibration = coefficients("belief").copy()
        sizes = {
            **sizes,
            "coefficients": len(calibration),
            "sets": 2 if self._block else 1,
            "two": 2,
            "modes": MODES,
            "line": REACH + 3 * sizes["references"] + REACH_BACK,
        }
        given = {"batch": batch, "calibration": calibration}
        if hasattr(self, "state"):
            self.state = self.state.grown(sizes, **given)
        else:
            self.state = BeliefState(sizes, **given)
        self.link(batch)

    def begin(self, i: int, references: int) -> None:
        """Forget route ``i``."""
        begin(self.state, i, references)

    def link(self, batch: Batch) -> None:
        """Write the addresses of all arrays anew."""
        self.state.batch = batch
        routes = len(batch.active)
        threads = min(self._threads, routes)
        share = np.arange(routes) * threads // routes
        self._mine = np.arange(threads)[:, None] == share  # (threads, N) whose routes are whose
        self._parts = [
            self.state.beside(np.zeros_like(batch.active))
            for _ in range(threads if threads > 1 else 0)
        ]
        self._words = [part.write() for part in (self.state, *self._parts)]
        self._whole, *self._shares = [int(words.ctypes.data) for words in self._words]

    def repeated(self, batch: Batch, copies: int) -> BeliefEstimator:
        """For a batch in which every route stands ``copies`` times in a row."""
        twin = copy.copy(self)
        twin.state = self.state.repeated(copies, batch=batch)
        twin.link(batch)
        return twin

    def __getstate__(self) -> dict[str, Any]:
        """All but what :meth:`link` makes again."""
        made = ("_mine", "_parts", "_words", "_whole", "_shares")
        return {k: v for k, v in self.__dict__.items() if k not in made}

    def update(self) -> None:
        """Take the next frame of every active route."""
        self.filter()
        update_routes(self._whole)

    def filter(self) -> None:
        """Take the next frame of every active route into its belief."""
        prepare_rows(self._whole)  # others who drive on the same bank share them
        if not self._parts:
            filter_routes(self._whole)
            return
        for part, mine in zip(self._parts, self._mine, strict=True):
            np.logical_and(self.state.batch.active, mine, out=part.batch.active)
        left = deque(self._shares)
        waiting: list[Future[None]] = []
        try:
            try:
                for _ in self._shares[1:]:
                    waiting.append(_executor().submit(self._filter_some, left))
            except RuntimeError:  # the interpreter is about to end and starts no more threads
                pass
            self._filter_some(left)
        finally:  # nobody may write to what an interrupted step leaves behind
            _wait_for(waiting)

    def _filter_some(self, left: deque[int]) -> None:
        """Filter shares, given by their addresses, as long as there are any left."""
        while left:
            try:
                address = left.pop()
            except IndexError:  # another thread was faster
                return
            filter_routes(address)

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
