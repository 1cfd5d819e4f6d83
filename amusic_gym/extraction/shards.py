"""Shards: the pieces of work that workers do. Pure functions of a technique and their fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from amusic_gym.extraction.blocks import (
    Images,
    Stored,
    aligned,
    check_shape,
    describe_one,
    match_one,
)
from amusic_gym.techniques.protocol import Descriptor, Technique
from amusic_gym.utils.threads import one_thread

ATTEMPTS = 3
"""How often a shard is tried whose worker dies."""

Advance: TypeAlias = Callable[[int], object]
"""Called with an amount of work that was done."""


def nothing(done: int) -> None:
    """Progress callback that does nothing."""


class Shard(Protocol):
    """A piece of work: the same result in any process, in any order."""

    @property
    def key(self) -> str:
        """Under which the cache keeps the result."""
        ...

    @property
    def size(self) -> int:
        """How much work it is, for the progress bar."""
        ...

    def run(self, technique: Technique, advance: Advance = nothing) -> NDArray[np.float32]:
        """Do the work, and tell of every bit of ``size`` that is done."""
        ...

    def portable(self) -> Shard:
        """The same shard, holding arrays in place of files of the cache."""
        ...


S = TypeVar("S", bound=Shard)


@dataclass(frozen=True)
class DescribeShard:
    """Describe one block of images; the result is (B, ...).

    Attributes:
        key: of the result.
        images: up to ``BLOCK``.
        query: whether as queries or as places of the map.
    """

    key: str
    images: Images
    query: bool

    @property
    def size(self) -> int:
        """Images."""
        return len(self.images)

    def __str__(self) -> str:
        return f"describing {self.images.paths[0]} to {self.images.paths[-1].name}"

    def portable(self) -> DescribeShard:
        """Itself: images are read where the work is done."""
        return self

    def run(self, technique: Technique, advance: Advance = nothing) -> NDArray[np.float32]:
        """Read and describe the images one after the other.

        Raises:
            ValueError: for an image that cannot be read or described, with its path; for one that
                was changed since the run began.
        """
        with one_thread():
            first = self._describe(technique, 0)
            block = np.empty((len(self.images), *first.shape), np.float32)
            block[0] = first
            advance(1)
            for at in range(1, len(self.images)):
                descriptor = self._describe(technique, at)
                path = self.images.paths[at]
                check_shape(technique, descriptor.shape, first.shape, path)
                block[at] = descriptor
                advance(1)
        return block

    def _describe(self, technique: Technique, at: int) -> Descriptor:
        image = self.images.read(at)
        try:
            return describe_one(technique, image, query=self.query)
        except ValueError as error:
            raise _at(self.images.paths[at], error) from error.__cause__ or error


@dataclass(frozen=True)
class MatchShard:
    """Match one block of queries with one block of the map; the result is (queries, references).

    Attributes:
        key: of the result.
        queries: (B, ...) descriptors.
        references: (B, ...) descriptors.
        paths: B, the images of the queries.
    """

    key: str
    queries: Stored | NDArray[np.float32]
    references: Stored | NDArray[np.float32]
    paths: tuple[Path, ...]

    @property
    def size(self) -> int:
        """Pairs of a query and a reference."""
        return self.queries.shape[0] * self.references.shape[0]

    def __str__(self) -> str:
        return f"matching {self.queries.shape[0]} queries × {self.references.shape[0]} references"

    def portable(self) -> MatchShard:
        """The same with both arrays in it."""
        return replace(self, queries=_array(self.queries), references=_array(self.references))

    def run(self, technique: Technique, advance: Advance = nothing) -> NDArray[np.float32]:
        """Match the queries one by one, each as :func:`match_one` does it live.

        Raises:
            ValueError: for a query that cannot be matched, with its path.
        """
        queries, block = _array(self.queries), aligned(_array(self.references))
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
    """``error``, which says at which image it was."""
    return error if str(path) in str(error) else ValueError(f"{path}: {error}")


def _array(values: Stored | NDArray[np.float32]) -> NDArray[np.float32]:
    return values.array() if isinstance(values, Stored) else values
