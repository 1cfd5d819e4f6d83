"""What ``navigate`` matches its frames against: a map's folder, or images described now."""

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from typing import NamedTuple

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.banks.truth_files import read_truth
from amusic_gym.cli.images import map_of, techniques_of
from amusic_gym.cli.parser import by_technique, numbers, pairs
from amusic_gym.envs.frames import FrameSource, ImageSequence
from amusic_gym.extraction.cache import Cache
from amusic_gym.extraction.map import DescribedMap, describe_map
from amusic_gym.extraction.place_map import PlaceMap
from amusic_gym.extraction.thumbnails import Thumbnails
from amusic_gym.routes import image_truth
from amusic_gym.routes.folders import ImageFolder, check_apart
from amusic_gym.routes.positions import Positions
from amusic_gym.techniques import Technique

TECHNIQUES = "hog,cohog,calc,netvlad"  # of a map of images where none are named

_OF_IMAGES = ("reference", "techniques", "reference_positions", "cache")


class Described(NamedTuple):
    """A map, ready to be driven on."""

    maps: Sequence[DescribedMap]  # T of them
    images: ImageFolder | Thumbnails  # of its R places
    positions: Positions | None  # R of them; None where they are not known
    seconds: Mapping[str, float]  # technique's name -> seconds of a run, where they are known
    file: PlaceMap | None = None  # the map's folder; None for images


def from_file(args: argparse.Namespace, stack: ExitStack) -> Described:
    """The map of ``--map``."""
    for name in _OF_IMAGES:
        if getattr(args, name) is not None:
            raise ValueError(f"--{name.replace('_', '-')} does not go with --map, which brings it")
    weights = pairs(args.weights, "--weights")
    found = stack.enter_context(closing(PlaceMap.load(args.map, weights=weights)))
    given = numbers(by_technique(args.seconds, found.techniques, "--seconds"), "--seconds")
    known = dict(zip(found.techniques, found.seconds.tolist(), strict=True))
    return Described(found.maps, found.thumbnails, found.positions, {**known, **given}, found)


def techniques_for(args: argparse.Namespace) -> tuple[list[Technique], dict[str, float]]:
    """The techniques that describe ``--reference``, and what ``--seconds`` says."""
    if args.reference is None:
        raise ValueError("give --reference DIR, or --map MAP")
    args.techniques = TECHNIQUES if args.techniques is None else args.techniques
    return techniques_of(args)


def from_images(
    args: argparse.Namespace,
    techniques: Sequence[Technique],
    seconds: Mapping[str, float],
    frames: FrameSource,
    stack: ExitStack,
) -> Described:
    """The map of ``--reference``, described now or found in the cache."""
    places, here = map_of(args, stack)
    if isinstance(frames, ImageSequence):
        check_apart(places, frames.images)
        if isinstance(frames.images, ImageFolder):
            image_truth.warn_of_shared_files(places, frames.images)
    cache = stack.enter_context(Cache(args.cache))
    maps = [
        stack.enter_context(
            closing(describe_map(places, one, cache=cache, progress=not args.quiet))
        )
        for one in techniques
    ]
    return Described(maps, places, here, seconds)


def truth_of(
    args: argparse.Namespace,
    described: Described,
    frames: FrameSource,
    there: Positions | None,
    default: int,
) -> GroundTruth | None:
    """What is right, by ``--ground-truth`` or by the positions of both; None: nobody knows.

    ``default`` is the tolerance where a file gives one place per frame and ``--tolerance`` none.
    """
    folder = getattr(frames, "images", None)
    if args.ground_truth is not None:
        if not isinstance(folder, ImageFolder):
            raise ValueError("--ground-truth needs a --query whose length is known: a folder")
        how = {"tolerance": args.tolerance, "trust": args.trust, "default": default}
        if isinstance(described.images, ImageFolder):
            return image_truth.from_file(args.ground_truth, described.images, folder, **how)
        assert described.file is not None
        if folder.complete:
            raise ValueError("--skip-damaged does not go with --map and --ground-truth")
        names = (folder.names, described.file.names)
        size, parts = len(described.images), described.file.parts
        return read_truth(args.ground_truth, len(folder), size, parts=parts, names=names, **how)
    if described.positions is None or there is None:
        if args.within is not None or there is not None:
            needed = "--query-positions, and --reference-positions or a map with positions"
            raise ValueError(f"--within and --query-positions: what is right needs {needed}")
        return None
    metres = image_truth.METRES if args.within is None else args.within
    both = described.positions, there
    assert isinstance(folder, ImageFolder)
    return image_truth.by_position(described.images, folder, metres, positions=both)
