"""Fair timing of two sides in one run: one thread, interleaved, one warm-up, medians."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


def one_thread() -> None:
    """Keep every library to one thread; call it before NumPy, Numba or torch are imported."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"


class Side(NamedTuple):
    """One of two things to compare.

    Attributes:
        name: what is timed, for the table.
        work: the timed call.
        units: units of work (steps, corrections, bytes) of one call.
        prepare: brings the state back before every call; not timed.
    """

    name: str
    work: Callable[[], object]
    units: float
    prepare: Callable[[], object] = lambda: None


class Medians(NamedTuple):
    """Median seconds of one unit of work on either side."""

    ours: float
    theirs: float

    @property
    def faster(self) -> float:
        """How many times as many units our side does in the same time."""
        return self.theirs / self.ours


def interleave(ours: Side, theirs: Side, rounds: int) -> Medians:
    """Time both sides in turn, A B A B …, after one warm-up of each that is not counted.

    The median over the rounds forgives what else the machine does in a few of them; taking turns
    lets a slower spell meet both sides.
    """
    samples: tuple[list[float], list[float]] = ([], [])
    for number in range(rounds + 1):
        for side, kept in zip((ours, theirs), samples, strict=True):
            side.prepare()
            start = time.perf_counter()
            side.work()
            seconds = time.perf_counter() - start
            if number:
                kept.append(seconds / side.units)
    return Medians(*(statistics.median(kept) for kept in samples))


def alone(work: Callable[[], object], rounds: int) -> float:
    """Median seconds of a call, after one that is not counted."""
    samples = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        work()
        samples.append(time.perf_counter() - start)
    return statistics.median(samples[1:])


def readable(seconds: float) -> str:
    """A duration with three digits and its unit."""
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"
