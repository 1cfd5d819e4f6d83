"""What the tests of live routes share: small traverses, cheap techniques, and the bank of each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from amusic_baselines import make_policy
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.extraction.blocks import BLOCK, describe_one
from amusic_gym.extraction.map import DescribedMap
from amusic_gym.policies.protocol import Context
from amusic_gym.techniques.protocol import Descriptor, Image, Technique

NAMES = ("HOG", "CALC", "CoHOG")
SECONDS = (1.0, 2.0, 4.0)
TOLERANCE = 1


class Columns(Technique):
    """Mean of every ``width`` columns of one colour, coarsely rounded: cheap, and full of ties."""

    def __init__(self, name: str, width: int, colour: int) -> None:
        self.name, self.width, self.colour = name, width, colour

    def describe(self, image: Image) -> Descriptor:
        columns = image[..., self.colour].astype(np.float32).mean(0)
        means = columns.reshape(-1, self.width).mean(1)
        return np.round((means - means.mean()) / 16.0).astype(np.float32)


class Broken(Columns):
    """Gives what ``spoil`` makes of its scores for dark images."""

    def __init__(self, spoil: Any) -> None:
        super().__init__("HOG", 2, 0)
        self.spoil = spoil

    def match(self, query: Descriptor, references: Descriptor) -> NDArray[np.float32]:
        scores = super().match(query, references)
        return self.spoil(scores) if not query.any() else scores


class CountingMap:
    """A map that notes how often it was asked for scores."""

    def __init__(self, inner: DescribedMap) -> None:
        self.inner, self.calls = inner, 0
        self.technique, self.references = inner.technique, inner.references
        self.describe_query = inner.describe_query

    def scores(self, query: Descriptor) -> NDArray[np.float32]:
        self.calls += 1
        return self.inner.scores(query)


class Stream:
    """A source that gives each frame once, like a camera or a video.

    Args:
        images: its frames.
        knows: whether it tells its length when it comes to the last one, as a video does.
    """

    random_access = False

    def __init__(self, images: Sequence[Image], knows: bool = False) -> None:
        self.images, self.knows = images, knows
        self.name, self.length, self.next = "stream", None, 0

    def rewind(self) -> None:
        self.length, self.next = None, 0

    def read(self, frame: int) -> Image | None:
        assert frame == self.next, "frames are asked for in order, each once"
        self.next += 1
        if frame >= len(self.images):
            return None
        if self.knows and frame == len(self.images) - 1:
            self.length = len(self.images)
        return self.images[frame]


def techniques() -> list[Columns]:
    return [Columns(name, 1 + t, t) for t, name in enumerate(NAMES)]


def traverse(frames: int, seed: int, noise: float = 20.0) -> list[Image]:
    """A walk past one and the same wall, in noise of its own."""
    wall = np.random.default_rng(99).uniform(0, 255, (frames + 12, 3))
    rng = np.random.default_rng(seed)
    images = [wall[at : at + 12] + rng.normal(0.0, noise, (2, 12, 3)) for at in range(frames)]
    return [np.clip(image, 0, 255).astype(np.uint8) for image in images]


def map_of(images: Sequence[Image], technique: Technique) -> DescribedMap:
    """The map as extraction describes it, in memory."""
    described = [describe_one(technique, image, query=False) for image in images]
    stacked = [np.stack(described[at : at + BLOCK]) for at in range(0, len(images), BLOCK)]
    return DescribedMap(technique, stacked, threads=1)


def maps_of(references: int) -> list[DescribedMap]:
    images = traverse(references, seed=1)
    return [map_of(images, technique) for technique in techniques()]


def bank_of(maps: Sequence[Any], images: Sequence[Image], **options: Any) -> ScoreBank:
    """All scores of the images, computed beforehand."""
    scores = [[one.scores(one.describe_query(image)) for image in images] for one in maps]
    names = [one.technique.name for one in maps]
    options = {"seconds": SECONDS[: len(maps)], "name": "pair", **options}
    truth = np.minimum(np.arange(len(images)), maps[0].references - 1)
    return ScoreBank(np.array(scores), names, tolerance=TOLERANCE, ground_truth=truth, **options)


def live_of(maps: Sequence[Any], frames: Any, **options: Any) -> LiveRoute:
    """The same, to be computed when it is asked for."""
    options = {"seconds": SECONDS[: len(maps)], "name": "pair", "tolerance": TOLERANCE, **options}
    return LiveRoute(maps, frames, **options)


def pair(queries: int = 30, references: int = 20, **options: Any) -> tuple[ScoreBank, LiveRoute]:
    """A bank and a live route of the same images, with ground truth."""
    maps, images = maps_of(references), traverse(queries, seed=2)
    bank = bank_of(maps, images)
    return bank, live_of(maps, images, ground_truth=bank.truth, **options)


def policy_on(spec: str, route: Any, seed: int = 3) -> Any:
    """The policy behind ``spec`` for a route."""
    return make_policy(spec, Context.of(route, statistic="evidence", seed=seed))


class StoredMap:
    """A technique's rows of a bank, looked up by the frame's number, which the image holds.

    Args:
        bank: the bank.
        technique: its index.
        clock: called with the technique's index by every run.
    """

    def __init__(
        self, bank: ScoreBank, technique: int, clock: Any = lambda technique: None
    ) -> None:
        self.rows, self.index, self.clock = bank.scores[technique], technique, clock
        self.technique = Columns(bank.techniques[technique], 1, 0)
        self.references = bank.references

    def describe_query(self, image: Image) -> Descriptor:
        return image

    def scores(self, query: Descriptor) -> NDArray[np.float32]:
        self.clock(self.index)
        return np.array(self.rows[int(query[0, 0, 0]) + 256 * int(query[0, 0, 1])])


def numbered(frames: int) -> list[Image]:
    """Images that hold their numbers, for :class:`StoredMap`."""
    return [np.full((1, 1, 3), (n % 256, n // 256, 0), np.uint8) for n in range(frames)]


def played(bank: ScoreBank, clock: Any = lambda technique: None) -> LiveRoute:
    """A bank as a live route."""
    maps = [StoredMap(bank, t, clock) for t in range(len(bank.techniques))]
    options = {"seconds": bank.seconds, "tolerance": bank.tolerance, "name": bank.name}
    return live_of(maps, Stream(numbered(bank.queries)), **options)
