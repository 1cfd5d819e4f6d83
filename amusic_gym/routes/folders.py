"""A folder of images as a traverse: an ordered list of frames along a route."""

from __future__ import annotations

import operator
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from amusic_gym.checks import whole
from amusic_gym.routes.conditions import Change
from amusic_gym.routes.images import SUFFIXES, read_image
from amusic_gym.routes.numbering import gaps, natural_key, path_key, same_numbers
from amusic_gym.techniques.protocol import Image

_NAMED = 5  # frames that a warning names before it only counts
_CHUNK = 1 << 16  # bytes of two files that are compared at a time


@dataclass(frozen=True, init=False)
class ImageFolder:
    """The images of a folder in the natural order of their names: img2 before img10.

    Making one looks at names and file sizes and decodes nothing; ``folder[i]`` reads image i. It
    pickles and compares by the paths it found. Sub-folders are followed, links too, each real
    folder once. Files and folders whose names begin with a dot do not count.

    Only images at an even pace along the route make a traverse, so there is a `UserWarning` with
    the frames' numbers where that looks broken: numbers missing or used twice, and neighbouring
    files that are the same byte for byte (a stop, or frames written twice).

    Args:
        path: the folder.
        first: index of the first image to take.
        step: take each ``step``-th image from there.
        count: how many to take; None: all to the end.

    Raises:
        FileNotFoundError: when there is no such folder, or an image in it is a link to nothing.
        ValueError: when it holds no images, or fewer than asked for.

    Attributes:
        path: the folder; of joined folders, the one that holds them all.
        paths: (N,) the images' files.
        parts: images from each of the folders joined; their sum is N. One folder is one part.
        repeats: (first, last) of each run of neighbouring images with the same bytes.
        changes: what is done to each image once it is read, None where nothing is; () where
            nothing is done to any. See `under`.
    """

    path: Path
    paths: tuple[Path, ...] = field(repr=False)
    parts: tuple[int, ...]
    repeats: tuple[tuple[int, int], ...] = field(repr=False)
    changes: tuple[Change | None, ...] = field(repr=False)

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        first: int = 0,
        step: int = 1,
        count: int | None = None,
    ) -> None:
        folder = Path(path)
        taken = _take(_find_images(folder), folder, first, step, count)
        paths = tuple(found for found, _ in taken)
        repeats = _repeats(taken)
        self._set(folder, paths, (len(paths),), repeats)
        for sentence in _doubts(paths, repeats):
            warnings.warn(f"{folder}: {sentence}", UserWarning, stacklevel=2)

    @classmethod
    def join(cls, folders: Iterable[ImageFolder]) -> ImageFolder:
        """One traverse of several, end to end; ``parts`` remembers where each ends.

        Raises:
            ValueError: when there is none.
        """
        parts = list(folders)
        if not parts:
            raise ValueError("no folders to join; give at least one ImageFolder")
        above = os.path.commonpath([os.path.abspath(part.path) for part in parts])
        repeats: list[tuple[int, int]] = []
        paths: list[Path] = []
        changes: list[Change | None] = []
        for part in parts:
            changes += part.changes or [None] * len(part)
            repeats += [(a + len(paths), b + len(paths)) for a, b in part.repeats]
            paths += [Path(os.path.abspath(path)) for path in part.paths]
        joined = object.__new__(cls)
        lengths = tuple(length for part in parts for length in part.parts)
        joined._set(Path(above), tuple(paths), lengths, tuple(repeats), _or_none(changes))
        return joined

    def under(self, changes: Sequence[Change | None]) -> ImageFolder:
        """The same traverse, each image changed once it is read; the files stay as they are.

        Args:
            changes: N, in place of those that this traverse may have; None: leave that image.

        Raises:
            ValueError: for another number of them.
        """
        if len(changes) != len(self):
            raise ValueError(f"{len(changes)} changes for {len(self)} images; give one for each")
        changed = object.__new__(type(self))
        changed._set(self.path, self.paths, self.parts, self.repeats, _or_none(changes))
        return changed

    def _set(
        self,
        path: Path,
        paths: tuple[Path, ...],
        parts: tuple[int, ...],
        repeats: tuple[tuple[int, int], ...],
        changes: tuple[Change | None, ...] = (),
    ) -> None:
        object.__setattr__(self, "path", path)
        object.__setattr__(self, "paths", paths)
        object.__setattr__(self, "parts", parts)
        object.__setattr__(self, "repeats", repeats)
        object.__setattr__(self, "changes", changes)

    @property
    def names(self) -> tuple[str, ...]:
        """(N,) the files' names from the folder on, with ``/`` between."""
        return tuple(path.relative_to(self.path).as_posix() for path in self.paths)

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Image:
        at = operator.index(index)
        image = read_image(self.paths[at])
        change = self.changes[at] if self.changes else None
        return image if change is None else change.apply(image)

    def __iter__(self) -> Iterator[Image]:
        return map(self.__getitem__, range(len(self)))


def _or_none(changes: Sequence[Change | None]) -> tuple[Change | None, ...]:
    """``changes``; () where all are None, so that folders that read alike are equal."""
    return tuple(changes) if any(change is not None for change in changes) else ()


def _find_images(folder: Path) -> list[tuple[Path, int]]:
    """Image files below ``folder`` with their sizes in bytes, in natural order."""
    if not folder.is_dir():
        if folder.exists():
            raise ValueError(f"{folder} is a file; give the folder that holds the images")
        raise FileNotFoundError(f"{folder} does not exist; give the folder that holds the images")
    found: list[tuple[Path, int]] = []
    seen: set[tuple[int, int]] = set()
    pending = [folder]
    while pending:
        directory = pending.pop()
        status = directory.stat()
        if (status.st_dev, status.st_ino) in seen:  # a link to where we have been: loops end here
            continue
        seen.add((status.st_dev, status.st_ino))
        images, inner = _look_into(directory)
        found += images
        pending += sorted(inner, key=lambda path: natural_key(path.name), reverse=True)
    if not found:
        raise ValueError(
            f"{folder} holds no images; give a folder with files that end in {', '.join(SUFFIXES)}"
        )
    return sorted(found, key=lambda item: path_key(item[0].relative_to(folder)))


def _look_into(directory: Path) -> tuple[list[tuple[Path, int]], list[Path]]:
    """Images of one folder with their sizes, and its sub-folders."""
    images, inner = [], []
    with os.scandir(directory) as entries:
        for entry in entries:
            path = directory / entry.name
            named_so = path.suffix.lower() in SUFFIXES
            if entry.name.startswith("."):
                continue
            if _is_folder(entry):
                if named_so:
                    raise ValueError(f"{path} is a folder with the name of an image; rename it")
                inner.append(path)
            elif named_so:
                images.append((path, _size(entry, path)))
    return images, inner


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # a link to itself, or to where we may not look
        return False


def _size(entry: os.DirEntry[str], path: Path) -> int:
    try:
        return entry.stat().st_size
    except OSError as error:
        raise FileNotFoundError(
            f"{path} is a link to what cannot be read ({error.strerror}); copy the images again"
        ) from None


def _take(
    found: list[tuple[Path, int]], folder: Path, first: int, step: int, count: int | None
) -> list[tuple[Path, int]]:
    first, step = whole("first", first, 0), whole("step", step, 1)
    taken = found[first::step]
    if count is not None:
        count = whole("count", count, 1, " or None")
    wanted = count or 1
    if len(taken) < wanted:
        raise ValueError(
            f"{folder} holds {len(found)} images, but first={first}, step={step}, count={count} "
            f"needs {first + step * (wanted - 1) + 1}; take fewer"
        )
    return taken[:count]


def _repeats(files: Sequence[tuple[Path, int]]) -> tuple[tuple[int, int], ...]:
    """Runs of neighbouring files with the same bytes.

    Two different photographs seldom have the same size as files, so hardly any file is opened; and
    those of a kind that always has the same size differ within their first bytes.
    """
    runs: list[tuple[int, int]] = []
    for at, ((path, size), (following, its_size)) in enumerate(pairwise(files)):
        if size == its_size > 0 and _same_bytes(path, following):
            begin = runs.pop()[0] if runs and runs[-1][1] == at else at
            runs.append((begin, at + 1))
    return tuple(runs)


def _same_bytes(one: Path, other: Path) -> bool:
    with one.open("rb", buffering=0) as first, other.open("rb", buffering=0) as second:
        while True:
            piece = first.read(_CHUNK)
            if piece != second.read(_CHUNK):
                return False
            if not piece:
                return True


def _doubts(paths: Sequence[Path], repeats: Sequence[tuple[int, int]]) -> Iterator[str]:
    """What speaks against these images being one even traverse, a sentence each."""
    broken = "neighbouring frames must be neighbours on the route"
    if missing := gaps(paths):
        named = [f"{at} to {at + 1} ({paths[at].name}, {paths[at + 1].name})" for at in missing]
        yield f"numbers are missing from frame {_listed(named)}; {broken}: look for lost files"
    if doubled := same_numbers(paths):
        named = [f"{at} and {at + 1} ({paths[at].name}, {paths[at + 1].name})" for at in doubled]
        yield f"the same number is on frames {_listed(named)}; {broken}: keep one file of each"
    if repeats:
        named = [f"{first} to {last}" for first, last in repeats]
        yield (
            f"the same image is repeated in frames {_listed(named)}; {broken}: drop the copies, "
            "in both traverses alike"
        )


def _listed(items: Sequence[str]) -> str:
    more = f" and {len(items) - _NAMED} more" if len(items) > _NAMED else ""
    return ", ".join(items[:_NAMED]) + more
