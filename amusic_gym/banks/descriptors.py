"""Global descriptors in files, and the score rows of one traverse's against another's."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.scores import as_float32, check_rows
from amusic_gym.utils import reading
from amusic_gym.utils.names import suggest
from amusic_gym.utils.optional import optional

H5_SUFFIXES = (".h5", ".hdf5")
H5_KEY = "global_descriptor"  # the dataset that hloc keeps in an image's group
METRICS = ("dot", "l2", "cosine")

_NUMBERS = 2**25  # of float32 in memory per array: rows of scores, or queries
_PLACES = 2**23  # likewise, of the map's descriptors
_SAMPLE = 100  # descriptors that are looked at before work begins
_EVEN = 1.01  # ratio of lengths up to which all metrics rank alike

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Descriptors:
    """Global descriptors of N images in one or several files, read in blocks."""

    source: str  # what refusals call them: the path
    dimensions: int  # D
    rows: NDArray[np.int64]  # (N,) int64, row of each in the source, in the order of the traverse
    names: tuple[str, ...] | None  # of the source's rows, if it names them
    # gives rows of the source, (n, D) numbers of any dtype
    read: Callable[[NDArray[np.int64]], NDArray[Any]]

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, chosen: Sequence[int]) -> Descriptors:
        """Rows of the source in another order, (n,)."""
        return replace(self, rows=np.asarray(chosen, np.int64))

    def block(self, first: int, count: int) -> Floats:
        """(n, D) descriptors from ``first`` on; refuses NaN, infinity and those of zeros only."""
        rows = self.rows[first : first + count]
        block = as_float32(self.read(rows))
        sizes = np.abs(block).max(axis=1)  # NaN where one of its numbers is
        if not (np.isfinite(sizes) & (sizes > 0)).all():
            at = int(np.argmin(np.isfinite(sizes) & (sizes > 0)))
            name = f" ({self.names[rows[at]]})" if self.names else ""
            what = "is all zeros" if sizes[at] == 0 else "holds NaN or infinity (as float32)"
            raise ValueError(
                f"{self.source}: descriptor {rows[at]}{name} {what}; compute it again, or leave"
                " its image out"
            )
        return block


@dataclass(frozen=True)
class DescriptorPair:
    """The descriptors of one technique on a map and on a run.

    Raises:
        ValueError: for descriptors of different size, an unknown metric, or None where metrics
            differ.
    """

    technique: str  # its name
    reference: Descriptors  # of R places
    query: Descriptors  # of Q frames
    # one of `METRICS`; None: the dot product, where all descriptors are equally long and every
    # metric ranks alike
    metric: str | None = None

    def __post_init__(self) -> None:
        here, there = self.reference, self.query
        if here.dimensions != there.dimensions:
            raise ValueError(
                f"technique {self.technique!r}: descriptors of {here.source} have "
                f"{here.dimensions} numbers, those of {there.source} {there.dimensions}; give two"
                " sets of one network"
            )
        if self.metric is None:  # before long work
            for each in self.sides:
                self._checked(each.block(0, _SAMPLE))
        elif self.metric not in METRICS:
            raise ValueError(suggest("metric", self.metric, METRICS))

    @property
    def sides(self) -> tuple[Descriptors, Descriptors]:
        """Those of the map, those of the run."""
        return self.reference, self.query

    def __len__(self) -> int:
        """Q · R, the pairs of images."""
        return len(self.query) * len(self.reference)

    def check_counts(self, references: int, queries: int) -> None:
        """Refuse other numbers of descriptors than there are places and frames."""
        if (len(self.reference), len(self.query)) != (references, queries):
            raise ValueError(
                f"technique {self.technique!r} has descriptors of {len(self.reference)} places and"
                f" {len(self.query)} frames where there are {references} and {queries}; give one"
                " of each image"
            )

    def check_apart(self) -> None:
        """Refuse a run that is the map: each frame would be found by itself."""
        here, there = self.sides
        same = os.path.realpath(here.source) == os.path.realpath(there.source)
        if same and np.array_equal(here.rows, there.rows):
            raise ValueError(
                f"{here.source} is given for the map and for the run, so each frame would match"
                " itself; give FILE.h5/GROUP or the names of the images of each, or, for loop"
                " closure, --exclude-recent N"
            )

    def score_rows(
        self, advance: Callable[[int], object] = lambda done: None
    ) -> Iterator[NDArray[np.float32]]:
        """The score rows, (n, R) at a time; ``advance`` is told how many pairs were compared.

        The map is read once for each.

        Raises:
            ValueError: as :meth:`Descriptors.block`; for a score that float32 cannot hold.
        """
        queries, places, size = len(self.query), len(self.reference), self.query.dimensions
        step = max(1, _NUMBERS // max(places, size))
        for first in range(0, queries, step):
            seen = self._checked(self.query.block(first, step))
            rows = np.empty((len(seen), places), np.float32)
            for begin in range(0, places, max(1, _PLACES // size)):
                block = self._checked(self.reference.block(begin, max(1, _PLACES // size)))
                rows[:, begin : begin + len(block)] = similarity(seen, block, self.metric or "dot")
                advance(len(seen) * len(block))
            check_rows(self.technique, rows, first)
            yield rows

    def _checked(self, block: Floats) -> Floats:
        """The block, unless no metric was chosen and its descriptors are not equally long."""
        if self.metric is None:
            vectors = np.concatenate([self.reference.block(0, 1), block])
            lengths = np.linalg.norm(vectors, axis=1)
            if lengths.max() > _EVEN * lengths.min():
                raise ValueError(
                    f"technique {self.technique!r}: its descriptors have lengths from"
                    f" {lengths.min():.4g} to {lengths.max():.4g}, so metrics rank differently;"
                    " give the one that its network was trained for, --metric"
                    f" {self.technique}=dot|l2|cosine"
                )
        return block


def similarity(queries: Floats, places: Floats, metric: str) -> NDArray[np.floating[Any]]:
    """Scores (n, m) of queries (n, D) on places (m, D), higher = more similar.

    ``dot``: the dot product; ``cosine``: that of the descriptors scaled to length 1; ``l2``: the
    Euclidean distance, negated, computed in float64: alike descriptors cancel.
    """
    if metric == "l2":
        wide, here = queries.astype(np.float64), places.astype(np.float64)
        squares = np.einsum("nd,nd->n", wide, wide)[:, None] + np.einsum("nd,nd->n", here, here)
        squares -= 2.0 * (wide @ here.T)
        return np.asarray(-np.sqrt(np.maximum(squares, 0.0)))
    with np.errstate(over="ignore", invalid="ignore"):  # refused as no finite score
        if metric == "cosine":
            queries, places = (
                each / np.linalg.norm(each.astype(np.float64), axis=1, keepdims=True)
                for each in (queries, places)
            )
        return np.asarray(queries @ places.T)


def from_npy(path: Path) -> Descriptors:
    """Those of a .npy file, one per row.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for another shape or dtype.
    """
    with reading.open_file(path) as file:
        header = reading.read_npy_header(file, path)
    if header.dtype.kind in "UST":
        raise ValueError(f"{path} lists names ({header.dtype}); give the file of descriptors")
    _check(path, header.shape, header.dtype, 2)

    def read(rows: NDArray[np.int64]) -> NDArray[Any]:
        return np.asarray(header.mapped(path)[rows])

    count, dimensions = header.shape
    return Descriptors(str(path), dimensions, np.arange(count), None, read)


def from_npy_files(folder: Path, paths: Sequence[Path]) -> Descriptors:
    """Those of a folder with a .npy file for each image, (D,) or (1, D); names without ``.npy``.

    Raises:
        ValueError: for another shape or dtype, or files of different size, naming the file.
    """

    def one(path: Path) -> NDArray[Any]:
        array = reading.read_array(path)
        _check(path, array.shape[array.ndim > 1 and array.shape[0] == 1 :], array.dtype, 1)
        return array.ravel()

    dimensions = one(paths[0]).size
    names = tuple(path.relative_to(folder).with_suffix("").as_posix() for path in paths)
    labels = [str(path) for path in paths]

    def read(rows: NDArray[np.int64]) -> NDArray[Any]:
        return _stack(((labels[row], one(paths[row])) for row in rows), len(rows), dimensions)

    return Descriptors(str(folder), dimensions, np.arange(len(paths)), names, read)


def from_h5(path: Path, group: str = "") -> Descriptors:
    """Those below a group ("": all) of a file as hloc writes it: a group per image, by its path.

    Raises:
        ValueError: without h5py; when it is no such file, or has no such group.
    """
    h5py = optional("h5py", str(path), "the package h5py", "hdf5")
    reading.open_file(path).close()  # refuses what is no file
    found: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}

    def visit(name: str, item: Any) -> None:
        where, _, key = name.rpartition("/")
        if key == H5_KEY and isinstance(item, h5py.Dataset):
            found[where] = item.shape, item.dtype

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except (OSError, RuntimeError, KeyError) as error:
        raise ValueError(f"{path} is no HDF5 file, or damaged ({error}); copy it again") from None
    names = [name for name in found if not group or name.startswith(f"{group}/")]
    if not names:
        below = f" below {group!r}" if group else ""
        raise ValueError(
            f"{path} holds no {H5_KEY}{below}; give a file of global features as hloc writes it"
        )
    for name in names:
        _check(f"{path}/{name}/{H5_KEY}", *found[name], 1)

    def read(rows: NDArray[np.int64]) -> NDArray[Any]:
        with h5py.File(path, "r") as file:
            each = ((f"{path}/{names[row]}", file[names[row]][H5_KEY][()]) for row in rows)
            return _stack(each, len(rows), dimensions)

    dimensions = found[names[0]][0][0]
    source = f"{path}/{group}" if group else str(path)
    return Descriptors(source, dimensions, np.arange(len(names)), tuple(names), read)


def _stack(each: Iterator[tuple[str, NDArray[Any]]], count: int, dimensions: int) -> Floats:
    block = np.empty((count, dimensions), np.float32)
    for at, (what, values) in enumerate(each):
        if values.shape != (dimensions,):
            raise ValueError(
                f"{what} has {values.size} numbers, and the others have {dimensions}; compute it"
                " again with the same network"
            )
        block[at] = as_float32(values)
    return block


def _check(what: object, shape: tuple[int, ...], dtype: np.dtype[Any], axes: int) -> None:
    if len(shape) != axes or 0 in shape or dtype.kind not in "fiu":
        wanted = "one row of numbers for each image" if axes == 2 else "the numbers of one image"
        raise ValueError(f"{what} has shape {shape} and dtype {dtype}; give {wanted}")
