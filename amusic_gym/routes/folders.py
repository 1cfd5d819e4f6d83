"""A folder of images as a traverse: an ordered list of frames along a route."""

from __future__ import annotations

import copy
import filecmp
import operator
import os
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from amusic_gym.routes.conditions import Change
from amusic_gym.routes.images import (
    SUFFIXES,
    UNREAD_SUFFIXES,
    check_image,
    read_bytes,
    read_image,
)
from amusic_gym.routes.numbering import arranged, gaps, natural_key, same_numbers
from amusic_gym.techniques.protocol import Image
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import few
from amusic_gym.utils.reading import read_lines

_NAMED = 5  # frames that a warning names before it only counts


@dataclass(frozen=True, init=False)
class ImageFolder:
    """The images of a folder in the order of their names: img2 before img10, 7.033 before 7.1.

    Making one looks at names and file sizes and decodes nothing; ``folder[i]`` reads image i. It
    pickles and compares by the paths it found. Sub-folders are followed, links too, each real
    folder once. Files and folders whose names begin with a dot do not count. How names are read is
    said in `amusic_gym.routes.numbering.arranged`.

    Only images at an even pace along the route make a traverse, so there is a `UserWarning` with
    the frames' numbers where that looks broken: numbers missing or used twice, and neighbouring
    files that are the same byte for byte (a stop, or frames written twice). There is one, too,
    for images of several sub-folders, and for files that look like images and are not read.

    Args:
        path: the folder.
        order: names of images from the folder on, or the path of a text file with a name on each
            line: the traverse is these, in this order. None: all, in the order of their names.
        first: index of the first image to take.
        step: take each ``step``-th image from there.
        count: how many to take; None: all to the end.

    Raises:
        FileNotFoundError: when there is no such folder, or an image in it is a link to nothing.
        ValueError: when it holds no images, or fewer than asked for, or none of a name in
            ``order``; when names do not tell the order.

    Attributes:
        path: the folder; of joined folders, the one that holds them all.
        paths: (N,) the images' files.
        parts: images from each of the folders joined; their sum is N. One folder is one part.
        repeats: (first, last) of each run of neighbouring images with the same bytes.
        changes: what is done to each image once it is read, None where nothing is; () where
            nothing is done to any. See `under`.
        complete: the traverse before images were left out; None where none were. See `without`.
        kept: (N,) indices of the images in ``complete``; () where none were left out.
    """

    path: Path
    paths: tuple[Path, ...] = field(repr=False)
    parts: tuple[int, ...]
    repeats: tuple[tuple[int, int], ...] = field(default=(), repr=False)
    changes: tuple[Change | None, ...] = field(default=(), repr=False)
    complete: ImageFolder | None = field(default=None, repr=False)
    kept: tuple[int, ...] = field(default=(), repr=False)

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        order: Sequence[str] | str | os.PathLike[str] | None = None,
        first: int = 0,
        step: int = 1,
        count: int | None = None,
    ) -> None:
        folder = Path(path)
        found, unread = _find_images(folder)
        if order is None:
            found = _arranged(found, folder)
        else:
            found = _listed(found, folder, order)
        taken = _take(found, folder, first, step, count)
        paths = tuple(path for path, _ in taken)
        repeats = _repeats(taken)
        vars(self).update(path=folder, paths=paths, parts=(len(paths),), repeats=repeats)
        doubts = [*_apart(paths, folder, unread), *_doubts(paths, repeats, order is None)]
        for sentence in doubts:
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
        if any(part.complete for part in parts):
            raise ValueError("images were left out of a part; join first, then leave images out")
        above = os.path.commonpath([os.path.abspath(part.path) for part in parts])
        repeats: list[tuple[int, int]] = []
        paths: list[Path] = []
        changes: list[Change | None] = []
        for part in parts:
            changes += part.changes or [None] * len(part)
            repeats += [(a + len(paths), b + len(paths)) for a, b in part.repeats]
            paths += [Path(os.path.abspath(path)) for path in part.paths]
        return parts[0]._with(
            path=Path(above),
            paths=tuple(paths),
            parts=tuple(length for part in parts for length in part.parts),
            repeats=tuple(repeats),
            changes=_or_none(changes),
        )

    def under(self, changes: Sequence[Change | None]) -> ImageFolder:
        """The same traverse, each image changed once it is read; the files stay as they are.

        Args:
            changes: N, in place of those that this traverse may have; None: leave that image.

        Raises:
            ValueError: for another number of them.
        """
        if len(changes) != len(self):
            raise ValueError(f"{len(changes)} changes for {len(self)} images; give one for each")
        return self._with(changes=_or_none(changes))

    def damaged(self) -> dict[int, str]:
        """Index of each image that cannot be used -> why; reads every file and computes no pixel.

        Raises:
            FileNotFoundError: for an image that is not there any more.
        """
        found = {}
        for at, path in enumerate(self.paths):
            try:
                check_image(read_bytes(path), path)
            except ValueError as error:
                found[at] = str(error)
        return found

    def without(self, left_out: Iterable[int]) -> ImageFolder:
        """The traverse without some images; the others keep their numbers for ground truth.

        Raises:
            ValueError: when none would be left of a part, or some were left out before.
        """
        lost = set(left_out)
        if not lost:
            return self
        kept = [at for at in range(len(self)) if at not in lost]
        part_of = [part for part, length in enumerate(self.parts) for _ in range(length)]
        lengths = Counter(part_of[at] for at in kept)
        if self.complete is not None or len(lengths) < len(self.parts):
            raise ValueError(f"{self.path}: no image is left to use, or some were left out before")
        place = {at: number for number, at in enumerate(kept)}
        runs = [[place[at] for at in range(a, b + 1) if at in place] for a, b in self.repeats]
        return self._with(
            paths=tuple(self.paths[at] for at in kept),
            parts=tuple(lengths[part] for part in range(len(self.parts))),
            repeats=tuple((run[0], run[-1]) for run in runs if len(run) > 1),
            changes=_or_none([self.changes[at] for at in kept]) if self.changes else (),
            complete=self,
            kept=tuple(kept),
        )

    def _with(self, **fields: Any) -> ImageFolder:
        made = copy.copy(self)
        vars(made).update(fields)
        return made

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


Folder = ImageFolder | str | os.PathLike[str]


def folder_of(given: Folder) -> ImageFolder:
    """An image folder, of itself or of its path."""
    return given if isinstance(given, ImageFolder) else ImageFolder(given)


def check_apart(reference: object, query: object) -> None:
    """Refuse a map that holds the folder of its own run, or the other way round.

    Anything but an `ImageFolder` passes.

    Raises:
        ValueError: naming both.
    """
    if not (isinstance(reference, ImageFolder) and isinstance(query, ImageFolder)):
        return
    here, there = (Path(os.path.realpath(folder.path)) for folder in (reference, query))
    shared = set(map(os.path.realpath, reference.paths)) & set(map(os.path.realpath, query.paths))
    if here != there and shared:
        raise ValueError(
            f"{len(shared)} of the {len(query)} images of the run {query.path} are among the "
            f"{len(reference)} of the map {reference.path}; give a folder of its own for each"
        )


def _or_none(changes: Sequence[Change | None]) -> tuple[Change | None, ...]:
    """``changes``; () where all are None, so that folders that read alike are equal."""
    return tuple(changes) if any(change is not None for change in changes) else ()


def _find_images(folder: Path) -> tuple[list[tuple[Path, int]], list[str]]:
    """Image files below ``folder`` with their sizes in bytes; names of those that are not read."""
    if not folder.is_dir():
        if folder.exists():
            raise ValueError(f"{folder} is a file; give the folder that holds the images")
        raise FileNotFoundError(f"{folder} does not exist; give the folder that holds the images")
    found: list[tuple[Path, int]] = []
    unread: list[str] = []
    seen: set[tuple[int, int]] = set()
    pending = [folder]
    while pending:
        directory = pending.pop()
        status = directory.stat()
        if (status.st_dev, status.st_ino) in seen:  # a link to where we have been: loops end here
            continue
        seen.add((status.st_dev, status.st_ino))
        images, inner, others = _look_into(directory)
        found += images
        unread += others
        pending += sorted(inner, key=lambda path: natural_key(path.name), reverse=True)
    if not found:
        but = f", but {_unread(unread)}" if unread else ""
        raise ValueError(
            f"{folder} holds no images; give a folder with files that end in "
            f"{', '.join(SUFFIXES)}{but}"
        )
    return found, sorted(unread, key=natural_key)


def _arranged(found: list[tuple[Path, int]], folder: Path) -> list[tuple[Path, int]]:
    try:
        return [found[at] for at in arranged([path.relative_to(folder) for path, _ in found])]
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from None


def _listed(
    found: list[tuple[Path, int]], folder: Path, order: Sequence[str] | str | os.PathLike[str]
) -> list[tuple[Path, int]]:
    """The images of a list of names, in its order."""
    what = "order"
    if isinstance(order, str | os.PathLike):
        what = os.fspath(order)
        order = read_lines(Path(order))
    images = {path.relative_to(folder).as_posix(): (path, size) for path, size in found}
    for name, count in Counter(order).items():
        if name not in images or count > 1:
            why = "names it twice" if count > 1 else "names it, but it is no image of the folder"
            raise ValueError(f"{folder}: {name!r}: {what} {why}; give each image's name once")
    if not order:
        raise ValueError(f"{what} names no image of {folder}; give a name on each line")
    return [images[name] for name in order]


def _look_into(directory: Path) -> tuple[list[tuple[Path, int]], list[Path], list[str]]:
    """Images of one folder with their sizes, its sub-folders, and images that are not read."""
    images, inner, others = [], [], []
    with os.scandir(directory) as entries:
        for entry in entries:
            path = directory / entry.name
            named_so = path.suffix.lower() in SUFFIXES
            if entry.name.startswith("."):
                continue
            if os.path.isdir(entry):
                if named_so:
                    raise ValueError(f"{path} is a folder with the name of an image; rename it")
                inner.append(path)
            elif named_so:
                images.append((path, _size(entry, path)))
            elif path.suffix.lower() in UNREAD_SUFFIXES:
                others.append(entry.name)
    return images, inner, others


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

    Photographs seldom have the same size as files, so hardly any file is opened.
    """
    runs: list[tuple[int, int]] = []
    for at, ((path, size), (following, its_size)) in enumerate(pairwise(files)):
        if size == its_size > 0 and filecmp.cmp(path, following, shallow=False):
            begin = runs.pop()[0] if runs and runs[-1][1] == at else at
            runs.append((begin, at + 1))
    return tuple(runs)


def _apart(paths: Sequence[Path], folder: Path, unread: Sequence[str]) -> Iterator[str]:
    """What speaks against these being the images of one traverse, all of them."""
    pieces = Counter(path.parent.relative_to(folder).as_posix() for path in paths)
    if len(pieces) > 1:
        named = [f"{name} ({count})" for name, count in pieces.items()]
        yield (
            f"images of {len(pieces)} folders are read as one route, one after the other: "
            f"{few(named, _NAMED)}; give one of them if these are several cameras or traverses"
        )
    if unread:
        yield _unread(unread)


def _unread(names: Sequence[str]) -> str:
    suffix = names[0].rpartition(".")[2]
    return (
        f"{len(names)} files look like images but are not read ({few(names, _NAMED)}): convert "
        f"them, say by `magick mogrify -format jpg *.{suffix}`, or move them away"
    )


def _doubts(
    paths: Sequence[Path], repeats: Sequence[tuple[int, int]], by_name: bool
) -> Iterator[str]:
    """What speaks against these images being one even traverse, a sentence each."""
    broken = "neighbouring frames must be neighbours on the route"
    if by_name and (missing := gaps(paths)):
        named = [f"{at} to {at + 1} ({paths[at].name}, {paths[at + 1].name})" for at in missing]
        yield f"numbers are missing from frame {few(named, _NAMED)}; {broken}: look for lost files"
    if by_name and (doubled := same_numbers(paths)):
        named = [f"{at} and {at + 1} ({paths[at].name}, {paths[at + 1].name})" for at in doubled]
        yield f"the same number is on frames {few(named, _NAMED)}; {broken}: keep one file of each"
    if repeats:
        named = [f"{first} to {last}" for first, last in repeats]
        yield (
            f"the same image is repeated in frames {few(named, _NAMED)}; {broken}: drop the "
            "copies, in both traverses alike"
        )
