"""How time and memory grow with the map, up to a bank that is larger than memory should be."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from _bench_kernels import stream
from _bench_material import Corrections, Material, Sizes, same
from _bench_reference import gather
from _timing import Medians, Side, interleave

SIZES = (100, 1_000, 10_000, 100_000, 1_000_000)
QUICK_SIZES = (100, 400)
FRAMES, STEPS = 24, 8

BIG_SHAPE = (4, 2_000, 100_000)
"""T, Q, R of a bank of 3.2 GB."""

QUICK_SHAPE = (2, 40, 500)


def measure_growth(
    places: tuple[int, ...], report: Callable[[str, float, str], None]
) -> list[Medians]:
    """Time one SIC correction on maps of growing size, against the stream over its row.

    Args:
        places: sizes R of the maps.
        report: takes a key, its value, and a sentence on it.

    Returns:
        Seconds of both on each map.
    """
    found: list[Medians] = []
    for size in places:
        sizes = Sizes(techniques=1, places=size, frames=FRAMES, routes=1, steps=STEPS)
        material = Material(sizes)
        ours = Corrections(material)
        frame = FRAMES - 1
        ours.forward()
        values = gather(material.z[0], frame, material.top[0][frame], sizes.history)
        best = int(np.argmax(values))
        same(f"place of {size}", ours.places[0], int(material.top[0][frame][best]), 0.0)
        same(f"statistic of {size}", ours.statistics[0], float(values[best]), 1e-9)
        row, window = material.bank.scores[0], np.zeros((1, size))

        def stream_rows(row: np.ndarray = row, window: np.ndarray = window) -> None:
            for at in range(FRAMES - STEPS, FRAMES):
                stream(row[at : at + 1], window)

        stream_rows()
        medians = interleave(
            Side("correction", ours.forward, STEPS, ours.rewind),
            Side("stream", stream_rows, STEPS),
            sizes.rounds,
        )
        found.append(medians)
        times = medians.ours / medians.theirs
        what = f"µs per correction with {size} places: {times:.3g} times the stream over its row"
        report(f"sic_us_at_{size}", 1e6 * medians.ours, what)
    slope = math.log(found[-1].ours / found[-2].ours) / math.log(places[-1] / places[-2])
    report("growth_exponent", slope, "of the time with the map, at its largest: 1 is linear")
    return found


def measure_memory(material: Material, report: Callable[[str, float, str], None]) -> None:
    """Bytes of a route's state per technique, place and frame."""
    sizes, state = material.sizes, Corrections(material).state
    held = sum(array.nbytes for array in (state.sums, state.ran, state.counts, state.prefix))
    size = held / (sizes.routes * (sizes.places + sizes.frames))
    report("route_bytes_per_place", size, "bytes of a route's state per technique and R + Q")


def write_big(file: Path, shape: tuple[int, int, int]) -> None:
    """Scores of noise; their size is all that matters."""
    techniques, queries, places = shape
    scores = np.lib.format.open_memmap(file, "w+", np.float32, shape)
    noise = np.random.default_rng(0).standard_normal(places + queries + techniques, np.float32)
    for t in range(techniques):
        for query in range(queries):
            scores[t, query] = noise[query + t : query + t + places]
    scores.flush()


def measure_big(shape: tuple[int, int, int], report: Callable[[str, float, str], None]) -> None:
    """Run SIC on a large memory-mapped bank in a process that is short of memory.

    Args:
        shape: T, Q, R of the bank.
        report: takes a key, its value, and a sentence on it.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scores.npy"
        write_big(file, shape)
        child = Path(__file__).with_name("_bench_big.py")
        done = subprocess.run(
            [sys.executable, str(child), str(file)], capture_output=True, text=True, check=True
        )
    for key, (value, sentence) in json.loads(done.stdout).items():
        report(key, value, sentence)
