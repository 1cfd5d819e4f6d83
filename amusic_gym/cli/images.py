"""What the commands that read images share: folders, techniques, seconds; what they tell."""

import argparse
import os
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.cli.parser import by_technique, numbers
from amusic_gym.extraction.progress import Progress
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.position_files import EXIF, positions_of, read_track
from amusic_gym.routes.positions import Positions
from amusic_gym.routes.tours import Tour
from amusic_gym.routes.video_frames import frames_of
from amusic_gym.techniques import Technique, make_technique
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import few

_NAMED = 3  # damaged images that a warning names before it only counts


class Traverse(NamedTuple):
    """Images in the order in which they were taken, and where that was."""

    folder: ImageFolder
    positions: Positions | None = None


def map_of(args: argparse.Namespace, stack: ExitStack) -> Traverse:
    """The images of ``--reference``; those of a video are there until ``stack`` ends."""
    return traverse(args, args.reference, stack, args.reference_positions, 0)


def run_of(args: argparse.Namespace, stack: ExitStack) -> Traverse:
    """The images of ``--query``; likewise."""
    return traverse(args, args.query, stack, args.query_positions, -1)


def thinning(args: argparse.Namespace) -> dict[str, Any]:
    """Which frames of a video ``--every`` or ``--fps`` take."""
    if args.every is not None and args.fps is not None:
        raise ValueError("--every and --fps both thin a video; give one of the two")
    every = 1 if args.every is None else whole("--every", args.every, 1)
    return {"every": every, "fps": args.fps}


def traverse(
    args: argparse.Namespace,
    path: str | os.PathLike[str],
    stack: ExitStack,
    positions: str | None,
    side: int = 0,
) -> Traverse:
    """The images of a folder or a video, thinned and with positions as the options say."""
    metres, thinned = args.every_metres, thinning(args)
    if metres is not None and positions is None:
        raise ValueError(f"--every-metres needs the positions of {path}; give a file of them")
    if not Path(path).is_file():
        return _thinned(image_folder(args, path, side), positions, metres)
    if args.order or args.skip_damaged or positions == EXIF:
        raise ValueError(f"{path} is a video; --order, --skip-damaged and exif are of image files")
    track = None if positions is None else read_track(positions)
    with Progress(True).bar(Path(path).name, None, "frames") as advance:
        frames = frames_of(path, track=track, metres=metres, advance=advance, **thinned)
        return Traverse(*stack.enter_context(frames))


def _thinned(folder: ImageFolder, source: str | None, metres: float | None) -> Traverse:
    """A folder with positions, and of these an image each so many metres."""
    positions = None if source is None else positions_of(source, folder)
    if positions is None or metres is None:
        return Traverse(folder, positions)
    complete, taken = folder.complete or folder, positions.every(metres)
    kept = {(folder.kept or range(len(folder)))[at] for at in taken.tolist()}
    dropped = set(range(len(complete))) - kept
    return Traverse(complete.without(dropped), positions.take(taken))


def order_of(args: argparse.Namespace, side: int) -> Path | None:
    """The file of ``--order`` for the map (0) or the run (-1), if one was given."""
    if len(args.order) > 2:
        raise ValueError(f"--order has {len(args.order)} files; give one, or one for each folder")
    return args.order[side] if args.order else None


def image_folder(args: argparse.Namespace, path: str | os.PathLike[str], side: int) -> ImageFolder:
    """A folder of the map (0) or the run (-1), as ``--order`` and ``--skip-damaged`` have it."""
    folder = ImageFolder(path, order=order_of(args, side))
    damaged = folder.damaged() if args.skip_damaged else {}
    if damaged:
        told = few(list(damaged.values()), _NAMED, "; ")
        warnings.warn(
            f"{folder.path}: {len(damaged)} damaged images are left out, so neighbouring frames"
            f" may not be neighbours on the route: {told}",
            stacklevel=2,
        )
    return folder.without(damaged)


def specs_of(args: argparse.Namespace) -> tuple[list[str], dict[str, str]]:
    """What ``--techniques`` names, and the files of ``--weights`` by these names."""
    specs = [spec.strip() for spec in args.techniques.split(",") if spec.strip()]
    if not specs:
        raise ValueError("--techniques names none; give at least one")
    return specs, by_technique(args.weights, specs, "--weights")


def techniques_of(
    args: argparse.Namespace, others: Sequence[str] = ()
) -> tuple[list[Technique], dict[str, float]]:
    """The techniques of the command line, and the seconds that are given for some, by name.

    ``others`` are names of techniques that do not run here, and may have seconds.
    """
    specs, files = specs_of(args)
    how = {"device": args.device, "trust": args.trust}
    made = [make_technique(spec, files.get(spec), **how) for spec in specs]
    names = [*(technique.name for technique in made), *others]
    return made, numbers(by_technique(args.seconds, names, "--seconds"), "--seconds")


def extract_tour(tour: Tour, techniques: Any, tolerance: int, **options: Any) -> ScoreBank:
    """A tour's bank; ``techniques`` and ``options`` are those of `extract`."""
    from amusic_gym.extraction import extract

    return extract(
        tour.reference,
        tour.query,
        techniques,
        tolerance=tolerance,
        ground_truth=tour.ground_truth(tolerance),
        source=tour.source,
        **options,
    )


def tell(path: Path | None, shape: tuple[int, int, int]) -> None:
    """Print where a bank is, and how large."""
    techniques, queries, references = shape
    print(f"{path}: {techniques} techniques, {queries} queries, {references} references")
