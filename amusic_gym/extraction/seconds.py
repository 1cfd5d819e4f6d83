"""What one run of a technique costs on this machine."""

from __future__ import annotations

import os
import platform
import time
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from amusic_gym.extraction.blocks import Images, aligned, describe_one, match_one
from amusic_gym.extraction.cache import Cache
from amusic_gym.extraction.describe import Plan, describe
from amusic_gym.extraction.executors import Workers
from amusic_gym.extraction.progress import Progress
from amusic_gym.techniques.protocol import Descriptor, Image, Technique
from amusic_gym.utils.threads import one_thread

QUERIES = 5
"""Frames that are timed, after one to warm up."""

REPEATS = 3
"""How often each is timed, in rounds over all of them."""

STEADY = 0.25
"""Spread up to which a measurement is believed without a warning."""

SHORTEST = 1e-3
"""Seconds below which every clock's measurement spreads, and no cost turns on it."""

BLOCKS = 3
"""Blocks of the map that they are matched with; the time is scaled to the whole map."""


class Cost(NamedTuple):
    """What a run costs.

    Attributes:
        seconds: the median.
        spread: share of it by which the middle half of the runs of a frame differ from its median.
    """

    seconds: float
    spread: float

    def __str__(self) -> str:
        """For a person."""
        return f"{self.seconds:.4g} s per run (±{self.spread:.0%})"

    def warn(self, technique: str) -> None:
        """Warn where something else was running, or the technique is of no steady pace."""
        if self.spread > STEADY and self.seconds >= SHORTEST:
            warnings.warn(
                f"technique {technique!r} took {self}; measure again on an idle machine"
                " (--measure-again), or give its seconds",
                stacklevel=3,
            )


def cost_of(runs: ArrayLike) -> Cost:
    """Median and spread of the seconds of runs, (rounds, frames)."""
    taken = np.asarray(runs, np.float64)
    medians = np.median(taken, axis=0)
    low, high = np.percentile(taken / np.maximum(medians, np.finfo(float).tiny), [25, 75])
    return Cost(float(np.median(medians)), float(max(high - 1.0, 1.0 - low)))


def measure_cost(
    technique: Technique, images: Sequence[Image], blocks: Sequence[Descriptor], references: int
) -> Cost:
    """Seconds of one warm run on one thread: describe a query and match it with the whole map.

    Reading the image from disk does not count: on a robot it comes from a camera.

    Args:
        technique: the technique.
        images: some query images.
        blocks: some blocks of the map.
        references: R, places on the whole map.

    Returns:
        The median over the images of description + matching, the latter scaled from the given
        blocks to R references.
    """
    scale = references / sum(len(block) for block in blocks)
    with one_thread():
        _time_one(technique, images[0], blocks, scale)
        return cost_of(
            [
                [_time_one(technique, image, blocks, scale) for image in images]
                for _ in range(REPEATS)
            ]
        )


def _time_one(
    technique: Technique, image: Image, blocks: Sequence[Descriptor], scale: float
) -> float:
    begun = time.perf_counter()
    query = describe_one(technique, image, query=True)
    described = time.perf_counter()
    for block in blocks:
        match_one(technique, query, block)
    return described - begun + scale * (time.perf_counter() - described)


def known_cost(
    plan: Plan, cache: Cache, workers: Workers, progress: Progress, *, again: bool
) -> Cost:
    """Measured cost, or that which the cache remembers of this machine; warned of where unsteady.

    The same command gives the same bank twice, and does not measure while something else runs.

    Args:
        plan: of the technique.
        cache: remembers the measurement.
        workers: for blocks of the map that are not in the cache.
        progress: for these.
        again: measure even if there is a measurement.
    """
    chosen = _spread(range(len(plan.references)), BLOCKS)
    sample = _sample(plan.queries)
    references = sum(len(images) for images in plan.references)
    key = plan.key(
        "seconds",
        images=sample.keys,
        references=references,
        repeats=REPEATS,
        machine=[platform.node(), platform.machine(), os.cpu_count()],
    )
    known = None if again else cache.get(key)
    if known is None:
        stored = describe(plan, cache, workers, progress, query=False, only=chosen)
        measured = measure_cost(
            plan.technique,
            [sample.read(at) for at in range(len(sample))],
            [aligned(block.array()) for block in stored],
            references,
        )
        known = cache.put(key, np.array(measured, np.float32))
    seconds, spread = known.array().tolist()
    cost = Cost(float(f"{seconds:.4g}"), spread)  # more digits would be noise
    cost.warn(plan.technique.name)
    return cost


def _sample(queries: Sequence[Images]) -> Images:
    paths = tuple(path for images in queries for path in images.paths)
    digests = tuple(digest for images in queries for digest in images.digests)
    changes = tuple(change for images in queries for change in images.changes)
    return Images(paths, digests, changes).take(_spread(range(len(paths)), QUERIES))


def _spread(items: Sequence[int], count: int) -> list[int]:
    """Up to ``count`` of the items, evenly spread, the first and the last among them."""
    at = np.linspace(0, len(items) - 1, min(count, len(items)))
    return [items[round(index)] for index in at.tolist()]
