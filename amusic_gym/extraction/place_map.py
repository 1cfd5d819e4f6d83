"""A map in one folder: all that a robot needs to recognise its places, without the images."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.costs import declared_seconds
from amusic_gym.banks.scores import check_names
from amusic_gym.extraction import map_files
from amusic_gym.extraction.blocks import Stored, aligned
from amusic_gym.extraction.cache import Cache, opened
from amusic_gym.extraction.code import identity
from amusic_gym.extraction.describe import ExtractionPlan, describe, images_of
from amusic_gym.extraction.executors import make_executor
from amusic_gym.extraction.map import DescribedMap
from amusic_gym.extraction.map_files import DescribedBy, MapContents
from amusic_gym.extraction.progress import Progress
from amusic_gym.extraction.seconds import known_cost, measure_cost
from amusic_gym.extraction.thumbnails import Thumbnails
from amusic_gym.routes.folders import Folder, ImageFolder, folder_of
from amusic_gym.routes.positions import Positions
from amusic_gym.techniques import Image, Technique, make_technique
from amusic_gym.utils import storage
from amusic_gym.utils.names import suggest

_TIMED = 5  # images that a technique is timed with


@dataclass(frozen=True, eq=False)
class PlaceMap:
    """A described map, as :meth:`load` reads it and `build_map` and `append_to_map` write it.

    ``maps`` gives a `LiveRoute` the same rows as extraction from the images, bit for bit.

    Attributes:
        path: its folder.
        name: what it is called.
        maps: the map as each technique describes it.
        seconds: (T,) of a run of each, on the machine that the map was made on.
        thumbnails: R small images, for pictures.
        names: R names of images.
        parts: lengths of the traverses that it is joined of.
        positions: R of them; None where they are not known.
        digest: of its content.
    """

    path: Path
    name: str
    maps: tuple[DescribedMap, ...]
    seconds: NDArray[np.float64]
    thumbnails: Thumbnails
    names: tuple[str, ...]
    parts: tuple[int, ...]
    positions: Positions | None
    digest: str

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        techniques: Sequence[Technique] = (),
        weights: Mapping[str, str | Path] | None = None,
        threads: int | None = None,
        verify: bool = False,
    ) -> PlaceMap:
        """Read a map; its descriptors are memory-mapped.

        Args:
            path: the folder.
            techniques: in place of those that the map names, for techniques with arguments.
            weights: name of a technique -> its weights file, where that is not where it was.
            threads: see :class:`DescribedMap`.
            verify: compare the checksums of all files, which reads them.

        Raises:
            FileNotFoundError: when the folder, or a weights file, is not there.
            ValueError: when it is damaged or from a newer format; when a technique's class,
                parameters, weights or code are others than those that described the map.
        """
        path = Path(path)

        def read(folder: int) -> PlaceMap:
            contents = map_files.read(path, verify=verify)
            made = _techniques(path, contents.techniques, techniques, weights or {})
            found = cls._of(path, contents, made, threads)
            if storage.was_replaced(path, folder):
                raise FileNotFoundError(path)
            return found

        return storage.read_whole(path, "map", read)

    @classmethod
    def _of(
        cls, path: Path, contents: MapContents, made: Sequence[Technique], threads: int | None
    ) -> PlaceMap:
        maps = [
            DescribedMap(technique, blocks, threads=threads)
            for technique, blocks in zip(made, contents.descriptors, strict=True)
        ]
        return cls(
            path,
            contents.name,
            tuple(maps),
            np.array([each.seconds for each in contents.techniques]),
            contents.thumbnails,
            tuple(contents.names),
            tuple(contents.parts),
            contents.positions,
            contents.digest,
        )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def techniques(self) -> tuple[str, ...]:
        """T names."""
        return tuple(each.technique.name for each in self.maps)

    def close(self) -> None:
        """End the threads that match."""
        for each in self.maps:
            each.close()


def build_map(
    images: Folder,
    techniques: Sequence[str | Technique],
    out: str | os.PathLike[str],
    *,
    weights: Mapping[str, str | Path] | None = None,
    positions: Positions | None = None,
    seconds: Mapping[str, float] | None = None,
    name: str = "",
    cache: str | os.PathLike[str] | Cache | None = None,
    executor: str = "serial",
    progress: bool = False,
) -> Path:
    """Describe images by techniques and write that as a map.

    Args:
        images: the reference traverse, R images, or its folder.
        techniques: names as `make_technique` takes them, or techniques.
        out: the folder to write; a map that is there is replaced.
        weights: name, as in ``techniques``, -> weights file.
        positions: R of them.
        seconds: technique's name -> seconds of one run, for those that are not to be measured.
        name: of the map; by default the folder's of the images.
        cache: see `describe_map`.
        executor: likewise.
        progress: show a bar on a terminal, or one line elsewhere.

    Raises:
        FileNotFoundError: for an image or a weights file that is not there.
        ValueError: for what cannot be read or described, or an ``out`` that must not be replaced.
        OSError: when the map cannot be written; one that was there is still there.
    """
    given = {key: Path(value).absolute() for key, value in (weights or {}).items()}
    made = [_made(each, given) for each in techniques]
    folder = folder_of(images)
    if positions is not None and len(positions) != len(folder):
        raise ValueError(f"{len(positions)} positions for {len(folder)} images; give one for each")
    if not 0 < len(made) <= map_files.MOST_TECHNIQUES:
        raise ValueError(f"{len(made)} techniques; give 1 to {map_files.MOST_TECHNIQUES}")
    names = check_names([one.name for _, one in made])
    declared = declared_seconds(seconds or {}, names)
    map_files.check_destination(Path(out))
    described = _Described.of(folder, [one for _, one in made], cache, executor, progress, declared)
    about = [
        DescribedBy(
            spec, None if spec not in given else str(given[spec]), cost, identity(technique)
        )
        for (spec, technique), cost in zip(made, described.seconds, strict=True)
    ]
    contents = MapContents(
        name or folder.path.resolve().name,
        about,
        described.blocks,
        described.thumbnails,
        folder.names,
        folder.parts,
        positions,
    )
    map_files.write(Path(out), contents)
    return Path(out)


def append_to_map(
    path: str | os.PathLike[str],
    images: Folder,
    *,
    weights: Mapping[str, str | Path] | None = None,
    positions: Positions | None = None,
    cache: str | os.PathLike[str] | Cache | None = None,
    executor: str = "serial",
    progress: bool = False,
) -> Path:
    """Add the places of another traverse behind those of a map, described by its techniques.

    Arguments and errors are those of `build_map` and `PlaceMap.load`. The map is written anew, with
    positions where it has some.
    """
    path = Path(path)
    there = map_files.read(path, verify=True)  # else new checksums would vouch for damage
    made = _techniques(path, there.techniques, (), weights or {})
    folder = folder_of(images)
    if (there.positions is None) != (positions is None):
        raise ValueError(
            f"{path} has {'no ' if there.positions is None else ''}positions; add images"
            f" {'without' if there.positions is None else 'with their positions (--positions)'}"
        )
    both = None if positions is None else there.positions.joined(positions)  # type: ignore[union-attr]
    described = _Described.of(folder, made, cache, executor, progress, {})
    blocks = [
        map_files.joined(pair) for pair in zip(there.descriptors, described.blocks, strict=True)
    ]
    costs = [
        measure_cost(one, described.samples, [aligned(held[0])], sum(map(len, held)))
        for one, held in zip(made, blocks, strict=True)
    ]
    about = [
        replace(each, seconds=float(f"{cost.seconds:.4g}"))
        for each, cost in zip(there.techniques, costs, strict=True)
    ]
    contents = replace(
        there,
        techniques=about,
        descriptors=blocks,
        thumbnails=there.thumbnails.joined(described.thumbnails),
        names=[*there.names, *folder.names],
        parts=[*there.parts, *folder.parts],
        positions=both,
    )
    map_files.write(path, contents)
    return path


@dataclass(frozen=True)
class _Described:
    """What techniques made of a folder's images."""

    blocks: list[list[Stored]]
    seconds: list[float]
    thumbnails: Thumbnails
    samples: list[Image]

    @classmethod
    def of(
        cls,
        folder: ImageFolder,
        techniques: Sequence[Technique],
        cache: str | os.PathLike[str] | Cache | None,
        executor: str,
        progress: bool,
        seconds: Mapping[str, float],
    ) -> _Described:
        images, say = images_of(folder), Progress(progress)
        blocks, costs = [], []
        with opened(cache) as store, make_executor(executor) as where:
            for one in techniques:
                plan = ExtractionPlan(one, images, images)
                with where.workers(one) as workers:
                    stored = describe(plan, store, workers, say, query=False)
                    cost = seconds.get(one.name)
                    if cost is None:
                        cost = known_cost(plan, store, workers, say, again=False).seconds
                blocks.append(stored)
                costs.append(cost)
                say.line(f"{one.name}: {len(images)} places; {cost:.4g} s per run")
            if store.is_temporary:
                blocks = [map_files.joined([each]) for each in blocks]  # type: ignore[misc]
        with say.bar("thumbnails", len(images), "images") as advance:
            thumbnails = Thumbnails.of(images, advance)
        samples = [images.read(at) for at in range(min(_TIMED, len(images)))]
        return cls(blocks, costs, thumbnails, samples)


def _made(given: str | Technique, weights: Mapping[str, Path]) -> tuple[str, Technique]:
    """A technique and how to make it again."""
    if isinstance(given, str):
        return given, make_technique(given, weights.get(given))
    kind = type(given)
    return f"{kind.__module__}:{kind.__qualname__}", given


def _techniques(
    path: Path,
    described: Sequence[DescribedBy],
    given: Sequence[Technique],
    weights: Mapping[str, str | Path],
) -> list[Technique]:
    """The techniques of a map, made here; refused where they would describe otherwise."""
    files = {name.casefold(): file for name, file in weights.items()}
    own = {one.name: one for one in given}
    for name in (*files, *own):
        if name.casefold() not in {each.name.casefold() for each in described}:
            raise ValueError(f"{path}: {suggest('technique', name, [d.name for d in described])}")
    made = []
    for each in described:
        file = files.get(each.name.casefold(), each.weights)
        technique = own.get(each.name) or make_technique(each.spec, file)
        _compare(path, each, identity(technique))
        made.append(technique)
    return made


def _compare(path: Path, there: DescribedBy, here: Mapping[str, Any]) -> None:
    """Refuse a technique whose rows would not be those of the map."""
    who, mend = (
        f"technique {there.name!r} of the map {path}",
        "build the map anew (amusic map build)",
    )
    was = there.identity
    if here["class"] != was["class"]:
        raise ValueError(f"{who} is of class {was['class']}, here {here['class']}; {mend}")
    for name in sorted({*was["parameters"], *here["parameters"]}):
        old, new = (each["parameters"].get(name) for each in (was, here))
        if old != new:
            own = f"give the weights that the map was described by (--weights), or {mend}"
            raise ValueError(
                f"{who} was described with {name} {old!r}, here it is {new!r};"
                f" {own if name == 'weights' else mend}"
            )
    if here["code"] != was["code"]:
        raise ValueError(f"{who} was described by other code than is here; {mend}")
    for library, version in was["libraries"].items():
        if here["libraries"].get(library) != version:
            warnings.warn(
                f"{who} was described with {library} {version}, here it is"
                f" {here['libraries'].get(library)}: scores may differ in their last digits;"
                f" if in doubt, {mend}",
                stacklevel=4,
            )
