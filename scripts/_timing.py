"""Fair timing of two sides in one run: one thread, interleaved, one warm-up, medians."""

import os
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple


def one_thread() -> None:
    """Keep every library to one thread; call it before NumPy, Numba or torch are imported."""
    for library in ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "NUMBA_NUM", "VECLIB_MAXIMUM"):
        os.environ[f"{library}_THREADS"] = "1"


class Side(NamedTuple):
    """One of two things to compare."""

    name: str  # what is timed, for the table
    work: Callable[[], object]  # the timed call
    units: float  # units of work (steps, corrections, bytes) of one call
    # brings the state back before every call; not timed
    prepare: Callable[[], object] = lambda: None


def interleave(ours: Side, theirs: Side, rounds: int) -> tuple[float, float]:
    """Median seconds of one unit of work on either side, after one warm-up that is not counted.

    The sides take turns, A B A B …, so that a slower spell of the machine meets both; the median
    over the rounds forgives what else it does in a few of them.
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
    return statistics.median(samples[0]), statistics.median(samples[1])


def readable(seconds: float) -> str:
    """A duration with three digits and its unit."""
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"
