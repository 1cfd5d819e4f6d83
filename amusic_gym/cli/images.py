"""What the commands that read images share: folders, techniques, seconds; what they tell."""

from __future__ import annotations

import argparse
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from amusic_gym.cli.parser import by_technique, numbers
from amusic_gym.routes.folders import ImageFolder

if TYPE_CHECKING:
    from amusic_gym.techniques import Technique

_NAMED = 3  # damaged images that a warning names before it only counts


def map_of(args: argparse.Namespace) -> ImageFolder:
    """The folder of ``--reference``."""
    return _folder(args, args.reference, 0)


def run_of(args: argparse.Namespace) -> ImageFolder:
    """The folder of ``--query``."""
    return _folder(args, args.query, -1)


def order_of(args: argparse.Namespace, side: int) -> Path | None:
    """The file of ``--order`` for the map (0) or the run (-1), if one was given."""
    if len(args.order) > 2:
        raise ValueError(f"--order has {len(args.order)} files; give one, or one for each folder")
    return args.order[side] if args.order else None


def _folder(args: argparse.Namespace, path: str | os.PathLike[str], side: int) -> ImageFolder:
    folder = ImageFolder(path, order=order_of(args, side))
    damaged = folder.damaged() if args.skip_damaged else {}
    if damaged:
        told = "; ".join(list(damaged.values())[:_NAMED])
        more = f"; and {len(damaged) - _NAMED} more" if len(damaged) > _NAMED else ""
        warnings.warn(
            f"{folder.path}: {len(damaged)} damaged images are left out, so neighbouring frames"
            f" may not be neighbours on the route: {told}{more}",
            stacklevel=2,
        )
    return folder.without(damaged)


def techniques_of(
    args: argparse.Namespace, others: Sequence[str] = ()
) -> tuple[list[Technique], dict[str, float]]:
    """The techniques of the command line, and the seconds that are given for some, by name.

    Args:
        args: with ``techniques``, ``weights`` and ``seconds``.
        others: names of techniques that do not run here, and may have seconds.

    Raises:
        FileNotFoundError: for a file of weights that is not there.
        ValueError: for an unknown name, weights that do not fit, or seconds that are no number.
    """
    from amusic_gym.techniques import make_technique

    specs = [spec.strip() for spec in args.techniques.split(",") if spec.strip()]
    if not specs:
        raise ValueError("--techniques names none; give at least one")
    files = by_technique(args.weights, specs, "--weights")
    made = [make_technique(spec, files.get(spec)) for spec in specs]
    names = [*(technique.name for technique in made), *others]
    return made, numbers(by_technique(args.seconds, names, "--seconds"), "--seconds")


def tell(path: Path | None, shape: tuple[int, int, int]) -> None:
    """Print where a bank is, and how large."""
    techniques, queries, references = shape
    print(f"{path}: {techniques} techniques, {queries} queries, {references} references")
