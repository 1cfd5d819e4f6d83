"""Shards: the pieces of work that workers do. Pure functions of a technique and their fields."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

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
from amusic_gym.routes.images import decode_image, digest_of, read_bytes
from amusic_gym.techniques.protocol import Descriptor, Technique
from amusic_gym.threads import one_thread


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

    def run(self, technique: Technique) -> NDArray[np.float32]:
        """Do the work."""
        ...

    def portable(self) -> Shard:
        """The same shard, holding arrays in place of files of the cache."""
        ...


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

    def run(self, technique: Technique) -> NDArray[np.float32]:
        """Read and describe the images one after the other.

        Raises:
            ValueError: for an image that cannot be read or described, with its path; for one that
                was changed since the run began.
        """
        with one_thread():
            first = self._describe(technique, 0)
            block = np.empty((len(self.images), *first.shape), np.float32)
            block[0] = first
            for at in range(1, len(self.images)):
                descriptor = self._describe(technique, at)
                path = self.images.paths[at]
                check_shape(technique, descriptor.shape, first.shape, path)
                block[at] = descriptor
        return block

    def _describe(self, technique: Technique, at: int) -> Descriptor:
        path = self.images.paths[at]
        data = read_bytes(path)
        if digest_of(data) != self.images.digests[at]:
            raise ValueError(f"{path} was changed since this run began; run it again")
        try:
            return describe_one(technique, decode_image(data, path), query=self.query)
        except ValueError as error:
            if str(path) in str(error):
                raise
            raise ValueError(f"{path}: {error}") from error


@dataclass(frozen=True)
class MatchShard:
    """Match one block of queries with one block of the map; the result is (queries, references).

    Attributes:
        key: of the result.
        queries: (B, ...) descriptors.
        references: (B, ...) descriptors.
    """

    key: str
    queries: Stored | NDArray[np.float32]
    references: Stored | NDArray[np.float32]

    @property
    def size(self) -> int:
        """Pairs of a query and a reference."""
        return self.queries.shape[0] * self.references.shape[0]

    def __str__(self) -> str:
        return f"matching {self.queries.shape[0]} queries × {self.references.shape[0]} references"

    def portable(self) -> MatchShard:
        """The same with both arrays in it."""
        return replace(self, queries=_array(self.queries), references=_array(self.references))

    def run(self, technique: Technique) -> NDArray[np.float32]:
        """Match the queries one by one, each as :func:`match_one` does it live."""
        queries, block = _array(self.queries), aligned(_array(self.references))
        with one_thread():
            return np.stack([match_one(technique, query, block) for query in queries])


def _array(values: Stored | NDArray[np.float32]) -> NDArray[np.float32]:
    return values.array() if isinstance(values, Stored) else values
