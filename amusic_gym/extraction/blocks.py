"""Blocks of images: the unit in which a map is described, stored and matched.

A score may differ in its last bits with the number of references that it is computed together
with, with the number of threads and with where in memory its operands lie. So both the making of
a score bank and live navigation go through :func:`describe_one` and :func:`match_one`: one query
against one block, on one thread, from aligned memory.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.routes.conditions import Change
from amusic_gym.routes.images import decode_image, digest_of, read_bytes
from amusic_gym.techniques.own_code import guarded
from amusic_gym.techniques.protocol import Descriptor, Image, Technique
from amusic_gym.utils.threads import alone

BLOCK = 64  # references (and queries) per block
_ALIGNMENT = 64  # bytes: a cache line, and the widest registers


@dataclass(frozen=True)
class Images:
    """The images of a traverse, or of a block of it."""

    paths: tuple[Path, ...]  # N files, in the order of the traverse
    digests: tuple[str, ...]  # N digests of their contents
    # what is done to each once it is read, None where nothing is; () where nothing is done to any
    changes: tuple[Change | None, ...] = ()

    def __len__(self) -> int:
        return len(self.paths)

    @property
    def keys(self) -> tuple[str, ...]:
        """(N,) identifiers of the images that `read` gives: digest and change."""
        changes = self.changes or (None,) * len(self.digests)
        return tuple(
            digest if change is None else f"{digest} {change}"
            for digest, change in zip(self.digests, changes, strict=True)
        )

    def read(self, at: int) -> Image:
        """Image ``at``, changed as it is to be.

        Raises:
            FileNotFoundError: when the file is not there any more.
            ValueError: when its contents have another digest by now.
        """
        data = read_bytes(self.paths[at])
        if digest_of(data) != self.digests[at]:
            raise ValueError(f"{self.paths[at]} was changed since this run began; run it again")
        # What has the digest passed the check when that was taken.
        image = decode_image(data, self.paths[at], checked=True)
        change = self.changes[at] if self.changes else None
        return image if change is None else change.apply(image)

    def take(self, chosen: Sequence[int]) -> Images:
        """The images of these indices, in this order."""
        return Images(
            tuple(self.paths[at] for at in chosen),
            tuple(self.digests[at] for at in chosen),
            tuple(self.changes[at] for at in chosen) if self.changes else (),
        )

    def blocks(self) -> list[Images]:
        """The traverse in pieces of ``BLOCK`` images; the last may be shorter."""
        numbers = range(len(self))
        return [self.take(numbers[first : first + BLOCK]) for first in numbers[::BLOCK]]


@dataclass(frozen=True)
class Stored:
    """A float32 array in a file; it pickles as its address."""

    path: Path  # the file
    offset: int  # bytes before the first number, a multiple of 64
    shape: tuple[int, ...]  # of the array

    def array(self) -> NDArray[np.float32]:
        """The array, read-only; memory-mapped, so that only what is used is read."""
        try:
            mapped = np.memmap(self.path, np.float32, "r", self.offset, self.shape)
        except FileNotFoundError:
            raise FileNotFoundError(
                f"{self.path} was removed while it was in use; run the command again"
            ) from None
        return mapped.view(np.ndarray)


def array_of(values: Stored | NDArray[np.float32]) -> NDArray[np.float32]:
    """The array itself."""
    return values.array() if isinstance(values, Stored) else values


def aligned(array: NDArray[np.float32]) -> NDArray[np.float32]:
    """``array`` in C order, beginning at a multiple of 64 bytes; a copy only where it is not."""
    if array.flags.c_contiguous and array.ctypes.data % _ALIGNMENT == 0:
        return array
    memory = np.empty(array.nbytes + _ALIGNMENT, np.uint8)
    first = -memory.ctypes.data % _ALIGNMENT
    copy = memory[first : first + array.nbytes].view(np.float32).reshape(array.shape)
    copy[...] = array
    return copy


def describe_one(technique: Technique, image: Image, *, query: bool) -> Descriptor:
    """Descriptor of one image (H, W, 3) uint8, as a query or as a place of the map.

    Computed on one thread.

    Raises:
        ValueError: when the technique gives something else than an array of finite real numbers,
            or raises something, which is the cause.
    """
    describe = technique.describe_query if query else technique.describe
    given = guarded(f"technique {technique.name!r}", technique, alone, describe, image)
    return _descriptor(technique, given)


def describe_some(technique: Technique, images: Sequence[Image]) -> list[Descriptor]:
    """Descriptors of several images, all at once, as :func:`describe_one` gives them."""
    what = f"technique {technique.name!r}"
    given = guarded(what, technique, alone, technique.describe_batch, images)
    if len(given) != len(images):
        raise ValueError(f"{what} gives {len(given)} descriptors of {len(images)} images")
    return [_descriptor(technique, each) for each in given]


def _descriptor(technique: Technique, given: Any) -> Descriptor:
    """What a technique gave, refused where it is no descriptor."""
    descriptor = _floats(technique, given, "a descriptor")
    if np.ndim(given) == 0:
        raise ValueError(
            f"technique {technique.name!r} gives a single number as a descriptor; "
            "describe must give an array of at least one dimension"
        )
    return descriptor


def match_one(technique: Technique, query: Descriptor, block: Descriptor) -> NDArray[np.float32]:
    """Scores (B,) float32 of one query against one block (B, ...) of the map, on one thread.

    The block is :func:`aligned`.

    Raises:
        ValueError: when the technique gives something else than B finite real numbers, or raises
            something, which is the cause.
    """
    what = (
        f"technique {technique.name!r}, matching a query of shape {query.shape} with references "
        f"of shape {block.shape}"
    )
    given = guarded(what, technique, alone, technique.match, aligned(query), block)
    scores = _floats(technique, given, "scores")
    if scores.shape != (len(block),):
        raise ValueError(
            f"technique {technique.name!r} gives scores of shape {scores.shape} for "
            f"{len(block)} references; match must give one number for each"
        )
    return scores


def check_shape(
    technique: Technique,
    shape: tuple[int, ...],
    expected: tuple[int, ...],
    path: os.PathLike[str],
) -> None:
    """Refuse a descriptor of another shape than the traverse's first, with a ValueError."""
    if shape != expected:
        raise ValueError(
            f"technique {technique.name!r} describes {path} by shape {shape} and other images of "
            f"that traverse by {expected}; all must have one shape"
        )


def _floats(technique: Technique, values: object, what: str) -> NDArray[np.float32]:
    """The values as finite float32 numbers in C order; ``what`` names them in a refusal."""
    told = f"technique {technique.name!r} gives"
    array = guarded(f"{told} something else than {what}", technique, np.asarray, values)
    if array.dtype.kind not in "fiub" or array.size == 0:
        raise ValueError(
            f"{told} {what} of dtype {array.dtype} and shape {array.shape}; "
            "float32 numbers are expected"
        )
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite: refused next
        array = np.ascontiguousarray(array, np.float32)
    if not np.isfinite(array).all():
        raise ValueError(f"{told} {what} with NaN or infinity")
    return array
