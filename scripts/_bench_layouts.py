"""Layouts of SIC's sums that were tried, each as a loop of its own; none is used by the package."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from _bench_material import Corrections, Material, Sizes
from _timing import Side, interleave

from amusic_gym.banks.rows import mean_at, row_at, scale_at, top_at
from amusic_gym.estimation import sic
from amusic_gym.kernels.compiling import compiled

DOUBLES = 8
"""Numbers in a cache line."""


@compiled
def add_by_lines(sums: Any, marks: Any, runs: Any, frame: int) -> None:
    """Row add up to the window's next cache line first, so that no store crosses two of them."""
    for i in range(marks.size):
        row, base = row_at(runs[i], frame), marks[i].origin - frame
        mean, scale = mean_at(runs[i], frame)[0], scale_at(runs[i], frame)[0]
        window = sums[i][base : base + row.size]
        head = min(-np.int64(window.ctypes.data // 8) % DOUBLES, row.size)
        for place in range(head):
            window[place] += (row[place] - mean) * scale
        lines, scores = window[head:], row[head:]
        for place in range(scores.size):
            lines[place] += (scores[place] - mean) * scale


@compiled
def add_rows(sums: Any, marks: Any, runs: Any, frame: int) -> None:
    """Row add as it is: from the window's first place on."""
    for i in range(marks.size):
        sic.add_row(sums[i], marks[i].origin - frame, runs[i], frame, 1.0)


@compiled
def roots_and_divisions(
    sums: Any, marks: Any, runs: Any, frame: int, history: int, out: Any, places: Any
) -> None:
    """Statistics of the candidates in three loops: look-ups, roots and divisions, the highest."""
    for i in range(marks.size):
        top, window = top_at(runs[i], frame), sums[i][marks[i].origin - frame :]
        reach = min(history, frame)
        for rank in range(top.size):
            out[rank] = window[np.uintp(top[rank])]
        for rank in range(top.size):
            out[rank] = out[rank] / math.sqrt(min(reach, top[rank]) + 1.0)
        places[i] = top[sic.first_best(out, top.size)]


@compiled
def table_of_factors(
    sums: Any, marks: Any, runs: Any, frame: int, history: int, factors: Any, out: Any, places: Any
) -> None:
    """The same in one loop, with the factors looked up."""
    for i in range(marks.size):
        top, window = top_at(runs[i], frame), sums[i][marks[i].origin - frame :]
        reach, best = min(history, frame), -math.inf
        for rank in range(top.size):
            factor = factors[np.uintp(min(reach, top[rank]) + 1)]
            out[rank] = window[np.uintp(top[rank])] * factor
            best = max(best, out[rank])
        places[i] = top[sic.first_near(out, best, top.size)]


@compiled
def prefix_sums(
    before: Any, now: Any, marks: Any, runs: Any, frame: int, factors: Any, out: Any, places: Any
) -> None:
    """Sums as differences of two rows of prefix sums along the diagonals: one activity run."""
    for i in range(marks.size):
        top, best = top_at(runs[i], frame), -math.inf
        for rank in range(top.size):
            place = np.uintp(top[rank])
            out[rank] = (now[i, place] - before[i, place]) * factors[place]
            best = max(best, out[rank])
        places[i] = top[sic.first_near(out, best, top.size)]


def measure_layouts(material: Material, report: Callable[[str, float, str], None]) -> None:
    """Time what was rejected against what took its place.

    Args:
        material: of the bench.
        report: takes a key, its value (time of the rejected / of ours), and a sentence on it.
    """
    ours, sizes = Corrections(material), material.sizes
    frame, units = sizes.frames - 1, sizes.routes
    part = (ours.sums, ours.marks, ours.runs, frame)
    rest = (ours.values, ours.places)
    rng = np.random.default_rng(0)
    prefixes = rng.standard_normal((2, sizes.routes, sizes.places))
    now, before = prefixes

    def compare(key: str, rejected: Callable[[], object], kept: Callable[[], object]) -> None:
        for work in (rejected, kept):
            work()
        medians = interleave(
            Side("kept", kept, units, ours.rewind),
            Side("rejected", rejected, units, ours.rewind),
            10 * sizes.rounds,
        )
        times = f"{1e9 * medians.theirs:.3g} ns instead of {1e9 * medians.ours:.3g} ns"
        report(key, medians.faster, f"{times} per technique and frame")

    compare(
        "rejected_add_by_lines",
        lambda: add_by_lines(*part),
        lambda: add_rows(*part),
    )
    compare(
        "rejected_roots_and_divisions",
        lambda: roots_and_divisions(*part, sizes.history, *rest),
        lambda: table_of_factors(*part, sizes.history, ours.factors, *rest),
    )
    compare(
        "rejected_prefix_sums",
        lambda: prefix_sums(before, now, ours.marks, ours.runs, frame, ours.factors, *rest),
        lambda: ours.at(frame),
    )


def measure_waiting(places: tuple[int, ...], report: Callable[[str, float, str], None]) -> None:
    """Time corrections with rows that wait against rows that are added at once, by map size.

    Args:
        places: sizes R of the maps.
        report: takes a key, its value (time of waiting / of adding at once), and a sentence.
    """
    for size in places:
        routes = max(1, 64_000 // size)
        sizes = Sizes(techniques=1, places=size, frames=40, routes=routes, steps=16)
        material = Material(sizes)
        sides = []
        usual = sic.LARGE
        for large in (size + 1, 1):
            sic.LARGE = large
            sides.append(Corrections(material))
        sic.LARGE = usual
        once, waiting = sides
        units = routes * sizes.steps
        medians = interleave(
            Side("at once", once.forward, units, once.rewind),
            Side("waiting", waiting.forward, units, waiting.rewind),
            sizes.rounds,
        )
        times = f"{1e6 * medians.theirs:.3g} µs, added at once {1e6 * medians.ours:.3g} µs"
        report(f"waiting_at_{size}", medians.faster, f"{times} per correction")
