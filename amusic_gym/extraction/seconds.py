"""The cost of one run of a technique on this machine."""

import os
import platform
import time
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from amusic_gym.extraction.blocks import aligned, describe_one, match_one
from amusic_gym.extraction.cache import Cache
from amusic_gym.extraction.describe import ExtractionPlan, describe
from amusic_gym.extraction.progress import Progress
from amusic_gym.extraction.shards import Workers
from amusic_gym.techniques.protocol import Descriptor, Image, Technique
from amusic_gym.utils.threads import one_thread

QUERIES = 5  # query images that are timed, after one run to warm up
REPEATS = 3  # rounds over these images
STEADY = 0.25  # spread up to which a measurement is believed without a warning
SHORTEST = 1e-3  # seconds below which every clock's measurement spreads, and no cost turns on it
BLOCKS = 3  # blocks of the map that they are matched with; the time is scaled to the whole map


class Cost(NamedTuple):
    """Cost of a run."""

    seconds: float  # the median
    # share of it by which the middle half of the runs of an image differ from its median
    spread: float

    def __str__(self) -> str:
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

    Returns:
        The median over the images of description + matching, the latter scaled from the given
        blocks to R references.
    """
    scale = references / sum(len(block) for block in blocks)

    def run(image: Image) -> float:
        begun = time.perf_counter()
        query = describe_one(technique, image, query=True)
        described = time.perf_counter()
        for block in blocks:
            match_one(technique, query, block)
        return described - begun + scale * (time.perf_counter() - described)

    with one_thread():
        run(images[0])
        return cost_of([[run(image) for image in images] for _ in range(REPEATS)])


def known_cost(
    plan: ExtractionPlan, cache: Cache, workers: Workers, progress: Progress, *, again: bool
) -> Cost:
    """Cost from the cache, where it was measured on this machine before, or measured now.

    So the same command gives the same bank twice. An unsteady measurement is warned of.

    ``workers`` describe blocks of the map that are not in the cache.
    """
    references = len(plan.reference)
    sample = plan.query.take(_spread(len(plan.query), QUERIES))
    key = plan.key(
        "seconds",
        images=sample.keys,
        references=references,
        repeats=REPEATS,
        machine=[platform.node(), platform.machine(), os.cpu_count()],
    )
    known = None if again else cache.get(key)
    if known is None:
        chosen = _spread(len(plan.references), BLOCKS)
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


def _spread(size: int, count: int) -> list[int]:
    """Up to ``count`` indices below ``size``, evenly spread, the first and the last among them."""
    return [round(at) for at in np.linspace(0, size - 1, min(count, size)).tolist()]
