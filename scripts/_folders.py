"""Folders of images of the command line: their order, and what to do about damaged ones."""

from __future__ import annotations

import argparse
import os
import warnings
from pathlib import Path

from _cli import Parser

from amusic_gym.routes.folders import ImageFolder

_NAMED = 3  # damaged images that a warning names before it only counts


def add_reading(parser: Parser) -> None:
    """Add the options of both folders."""
    parser.add_argument(
        "--order",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="names of images, one on a line, in the order in which they were taken: one file for"
        " both folders, or one for the map and one for the run",
    )
    parser.add_argument(
        "--skip-damaged",
        action="store_true",
        help="leave damaged images out; the others keep their numbers for the ground truth",
    )


def map_of(args: argparse.Namespace) -> ImageFolder:
    """The folder of ``--reference``."""
    return _folder(args, args.reference, 0)


def run_of(args: argparse.Namespace) -> ImageFolder:
    """The folder of ``--query``."""
    return _folder(args, args.query, -1)


def _folder(args: argparse.Namespace, path: str | os.PathLike[str], side: int) -> ImageFolder:
    if len(args.order) > 2:
        raise ValueError(f"--order has {len(args.order)} files; give one, or one for each folder")
    folder = ImageFolder(path, order=args.order[side] if args.order else None)
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
