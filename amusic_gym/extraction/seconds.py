"""What one run of a technique costs on this machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Sequence

import numpy as np

from amusic_gym.extraction.blocks import Images, aligned, describe_one, match_one
from amusic_gym.extraction.cache import Cache
from amusic_gym.extraction.describe import Plan, describe
from amusic_gym.extraction.executors import Workers
from amusic_gym.extraction.progress import Progress
from amusic_gym.techniques.protocol import Descriptor, Image, Technique
from amusic_gym.threads import one_thread

QUERIES = 5
"""Frames that are timed, after one to warm up."""

BLOCKS = 3
"""Blocks of the map that they are matched with; the time is scaled to the whole map."""


def measure_seconds(
    technique: Technique, images: Sequence[Image], blocks: Sequence[Descriptor], references: int
) -> float:
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
        return float(np.median([_time_one(technique, image, blocks, scale) for image in images]))


def _time_one(
    technique: Technique, image: Image, blocks: Sequence[Descriptor], scale: float
) -> float:
    begun = time.perf_counter()
    query = describe_one(technique, image, query=True)
    described = time.perf_counter()
    for block in blocks:
        match_one(technique, query, block)
    return described - begun + scale * (time.perf_counter() - described)


def seconds_of(
    plan: Plan, cache: Cache, workers: Workers, progress: Progress, *, again: bool
) -> float:
    """Measured seconds, or those that the cache remembers of this machine.

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
        machine=[platform.node(), platform.machine(), os.cpu_count()],
    )
    known = None if again else cache.get(key)
    if known is None:
        stored = describe(plan, cache, workers, progress, query=False, only=chosen)
        value = measure_seconds(
            plan.technique,
            [sample.read(at) for at in range(len(sample))],
            [aligned(block.array()) for block in stored],
            references,
        )
        known = cache.put(key, np.array([value], np.float32))
    return float(f"{known.array()[0]:.4g}")  # more digits would be noise


def _sample(queries: Sequence[Images]) -> Images:
    paths = tuple(path for images in queries for path in images.paths)
    digests = tuple(digest for images in queries for digest in images.digests)
    changes = tuple(change for images in queries for change in images.changes)
    return Images(paths, digests, changes).take(_spread(range(len(paths)), QUERIES))


def _spread(items: Sequence[int], count: int) -> list[int]:
    """Up to ``count`` of the items, evenly spread, the first and the last among them."""
    at = np.linspace(0, len(items) - 1, min(count, len(items)))
    return [items[round(index)] for index in at.tolist()]
