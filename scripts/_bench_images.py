"""Techniques on images: describing one, CoHOG's matching, and a live route through a large map."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import _bench_reference as reference
import numpy as np
from _bench_material import same
from _timing import Medians, Side, alone, interleave
from amusic_baselines import make_policy
from numpy.typing import NDArray

from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.extraction import BLOCK
from amusic_gym.extraction.map import DescribedMap
from amusic_gym.live.navigation import Sighting, navigate
from amusic_gym.policies.protocol import Context
from amusic_gym.techniques import TECHNIQUES, Technique, make_technique
from amusic_gym.worlds import traverse

TOLERANCE = 2


class ImageSizes(NamedTuple):
    """What is measured."""

    images: int = 64  # rendered street frames
    places: int = 1000  # of the map that is driven through
    frames: int = 100  # of the drive
    rounds: int = 15
    product: int = 2048  # rows and columns of the matrices of the machine's product rate


class Roof(NamedTuple):
    """Operations per second that arithmetic allows, and those of CoHOG's matching."""

    product: float
    cohog: float


QUICK_IMAGES = ImageSizes(images=4, places=70, frames=3, rounds=1, product=256)


class Pictures:
    """Rendered frames, and what the techniques make of them.

    Args:
        sizes: how many.
    """

    def __init__(self, sizes: ImageSizes) -> None:
        self.sizes = sizes
        self.images = list(traverse(1, places=sizes.images, kind="street"))

    def technique(self, name: str) -> Technique:
        """A technique that has run once."""
        made = make_technique(name)
        made.describe_query(self.images[0])
        return made

    @cached_property
    def product_rate(self) -> float:
        """Multiplications and additions per second of a large matrix product, float32."""
        size = self.sizes.product
        matrix = np.random.default_rng(0).random((size, size), np.float32)
        return 2.0 * size**3 / alone(lambda: matrix @ matrix, self.sizes.rounds)


def describing(pictures: Pictures, name: str) -> float:
    """Seconds to describe one query image, warm."""
    technique, images = (
        pictures.technique(name),
        iter(pictures.images * (pictures.sizes.rounds + 1)),
    )
    return alone(lambda: technique.describe_query(next(images)), pictures.sizes.rounds)


class CoHOGMatching:
    """CoHOG's matching of one query with the other frames, and the same as a plain loop."""

    def __init__(self, pictures: Pictures) -> None:
        self.pictures = pictures
        self.technique = pictures.technique("cohog")
        self.query = self.technique.describe_query(pictures.images[0])
        self.map = np.stack([self.technique.describe(image) for image in pictures.images])
        regions = reference.cohog_regions(self.query)
        self.interest = regions[regions.any(axis=1)]
        self.regions = [np.ascontiguousarray(reference.cohog_regions(one)) for one in self.map]

    def ours(self) -> NDArray[np.float32]:
        """All frames at once."""
        return self.technique.match(self.query, self.map)

    def loop(self) -> list[float]:
        """One frame after the other."""
        return [reference.match_regions(self.interest, one) for one in self.regions]

    def measure(self) -> tuple[Medians, float]:
        """Seconds per reference on both sides, and those of the bare product of the cells."""
        for ours, theirs in zip(self.ours(), self.loop(), strict=True):
            same("CoHOG score", float(ours), theirs, 1e-5)
        count = len(self.map)
        sides = Side("compiled", self.ours, count), Side("NumPy", self.loop, count)
        medians = interleave(*sides, self.pictures.sizes.rounds)
        return medians, reference.COHOG_OPERATIONS / self.pictures.product_rate


def drive(
    pictures: Pictures, policy: str, names: tuple[str, ...], statistic: str
) -> list[Sighting]:
    """The frames of a live drive through a map of many places, after the first that warm up."""
    sizes = pictures.sizes
    maps = [_large_map(pictures, pictures.technique(name)) for name in names]
    frames = (pictures.images * (1 + sizes.frames // len(pictures.images)))[: sizes.frames + 2]
    route = LiveRoute(maps, frames, tolerance=TOLERANCE, seconds=[1.0] * len(maps))
    context = Context.of(route, statistic=statistic)
    return list(navigate(make_policy(policy, context), route, statistic=statistic))[2:]


def _large_map(pictures: Pictures, technique: Technique) -> DescribedMap:
    """A map of as many places as asked for: the frames' descriptors over and over, in memory."""
    places = pictures.sizes.places
    described = np.stack([technique.describe(image) for image in pictures.images])
    at = np.arange(places) % len(described)
    return DescribedMap(technique, [described[at[i : i + BLOCK]] for i in range(0, places, BLOCK)])


def measure_images(sizes: ImageSizes, report: Callable[[str, float, str], None]) -> Roof:
    """Measure everything of this file.

    Args:
        sizes: what is measured.
        report: takes a key, its value, and a sentence on it.

    Returns:
        Operations per second of a large matrix product and of CoHOG's matching.
    """
    pictures = Pictures(sizes)
    for name in TECHNIQUES:
        seconds = describing(pictures, name)
        report(f"{name}_describe_ms", 1e3 * seconds, "ms to describe a 320×240 query image")
    medians, limit = CoHOGMatching(pictures).measure()
    per = f"{1e3 * medians.ours:.3g} ms, NumPy loop {1e3 * medians.theirs:.3g} ms per reference"
    report("cohog_match_vs_numpy", medians.faster, per)
    bare = f"the bare product of the cells would take {1e3 * limit:.3g} ms"
    report("cohog_match_share_of_limit", limit / medians.ours, bare)
    for prefix, statistic in (("", SICSettings.statistic), ("belief_", "belief")):
        seen = drive(pictures, "subset:HOG", ("hog",), statistic)
        wall = np.array([one.milliseconds for one in seen])
        if not prefix:
            places = f"frames/s of subset:HOG in a map of {sizes.places} places"
            report("live_hog_frames_per_second", float(1e3 / np.median(wall)), places)
        beyond = wall - [one.run_milliseconds.sum() for one in seen]
        what = f"ms per frame beyond the techniques, {statistic}"
        report(f"{prefix}live_overhead_ms", float(np.median(beyond)), what)
    return Roof(pictures.product_rate, reference.COHOG_OPERATIONS / medians.ours)
