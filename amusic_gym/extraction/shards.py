"""Shards, pieces of work of an extraction, a study or a search, and what runs them."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from amusic_gym.extraction.blocks import (
    Images,
    Stored,
    aligned,
    array_of,
    check_shape,
    describe_one,
    describe_some,
    match_one,
)
from amusic_gym.extraction.code import describes_queries_alike
from amusic_gym.techniques.protocol import Technique
from amusic_gym.utils.closing import Closing
from amusic_gym.utils.threads import one_thread

ATTEMPTS = 3  # how often a shard is tried whose worker dies
Advance: TypeAlias = Callable[[int], object]  # is told the amount of work done since the last call


def nothing(done: int) -> None:
    """Progress callback that does nothing."""


class Held(Protocol):
    """What workers hold for all shards: a technique, the banks of a study; it pickles."""

    @property
    def name(self) -> str: ...  # noqa: D102


class Shard(Protocol):
    """A piece of work: the same result in any process, in any order."""

    @property
    def size(self) -> int:
        """Amount of work, for the progress bar."""

    def run(self, held: Any, advance: Advance = nothing, /) -> Any:
        """The result, which pickles; ``advance`` is called with all of ``size``, bit by bit."""


S = TypeVar("S", bound=Shard)


class Workers(Closing):
    """Workers that hold one thing."""

    def run(self, shards: Iterable[S], advance: Advance = nothing) -> Iterator[tuple[S, Any]]:
        """Run all ``shards``, taken as workers become free; yield each with its result, unordered.

        ``advance`` is called image by image in this process, elsewhere shard by shard. An error
        inside a shard is raised here as it is; a shard whose worker died is run `ATTEMPTS` times
        in all.

        Raises:
            ChildProcessError: when a shard's worker died each time.
        """
        raise NotImplementedError


class Executor(Closing):
    """A place to run shards."""

    def workers(self, held: Held) -> Workers:
        """Workers for the shards of one technique, study or search."""
        raise NotImplementedError


@dataclass(frozen=True)
class DescribeShard:
    """Description of one block of images; the result is (B, ...)."""

    key: str  # of the result
    images: Images  # up to ``BLOCK``
    query: bool  # whether as queries or as places of the map

    @property
    def size(self) -> int:
        """Images."""
        return len(self.images)

    def __str__(self) -> str:
        return f"describing {self.images.paths[0]} to {self.images.paths[-1].name}"

    def run(self, technique: Technique, advance: Advance = nothing) -> NDArray[np.float32]:
        """Read and describe the images, as many at a time as the technique wants.

        Raises:
            ValueError: for an image that cannot be read or described, with its path; for one that
                was changed since the run began.
        """
        block = np.empty((0, 0), np.float32)  # as large as the first image's descriptor tells
        with one_thread():
            alike = not self.query or describes_queries_alike(technique)
            batch = technique.batch if alike else 1
            for first in range(0, len(self.images), batch):
                taken = range(first, min(first + batch, len(self.images)))
                images = [self.images.read(at) for at in taken]
                try:
                    if len(images) == 1:
                        described = [describe_one(technique, images[0], query=self.query)]
                    else:
                        described = describe_some(technique, images)
                except ValueError as error:
                    raise _at(self.images.paths[first], error) from error.__cause__ or error
                for at, descriptor in zip(taken, described, strict=True):
                    if at == 0:
                        block = np.empty((len(self.images), *descriptor.shape), np.float32)
                    shape = block.shape[1:]
                    check_shape(technique, descriptor.shape, shape, self.images.paths[at])
                    block[at] = descriptor
                advance(len(images))
        return block


@dataclass(frozen=True)
class MatchShard:
    """Matching of a block of queries with one of the map; the result is (queries, references)."""

    key: str  # of the result
    queries: Stored | NDArray[np.float32]  # (B, ...) descriptors
    references: Stored | NDArray[np.float32]  # (B, ...) descriptors
    paths: tuple[Path, ...]  # B, the images of the queries

    @property
    def size(self) -> int:
        """Pairs of a query and a reference."""
        return self.queries.shape[0] * self.references.shape[0]

    def __str__(self) -> str:
        return f"matching {self.queries.shape[0]} queries × {self.references.shape[0]} references"

    def run(self, technique: Technique, advance: Advance = nothing) -> NDArray[np.float32]:
        """Match the queries one by one, each as :func:`match_one` does it live; names a bad one."""
        queries, block = array_of(self.queries), aligned(array_of(self.references))
        scores = np.empty((len(queries), len(block)), np.float32)
        with one_thread():
            for row, query, path in zip(scores, queries, self.paths, strict=True):
                try:
                    row[:] = match_one(technique, query, block)
                except ValueError as error:
                    raise _at(path, error) from error.__cause__ or error
                advance(len(block))
        return scores


def _at(path: Path, error: ValueError) -> ValueError:
    """``error`` with the path of its image."""
    return error if str(path) in str(error) else ValueError(f"{path}: {error}")
