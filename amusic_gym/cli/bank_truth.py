"""What the commands that make banks are told of ground truth."""

from __future__ import annotations

import argparse
from typing import Any

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.cli.parser import Parser
from amusic_gym.routes import image_truth
from amusic_gym.routes.folders import ImageFolder


def add_truth(parser: Parser) -> None:
    """Add the arguments that `check_truth` and `truth_of` read."""
    add = parser.add_argument
    add(
        "--truth-by",
        choices=("index", "name", "position"),
        help="frame q is at place q (index, the default where there are as many); at the image "
        "with the same name; or near images by @UTM_EAST@UTM_NORTH@ in their names",
    )
    add("--metres", type=float, metavar="M", help="how near, with --truth-by position")
    add("--heading", type=float, metavar="D", help="likewise: seen within D degrees, too")
    parser.add_shared("--ground-truth", "--trust", "--tolerance", "--exclude-recent")


def check_truth(args: argparse.Namespace) -> None:
    """Refuse what contradicts itself, before any file is read.

    Raises:
        ValueError: naming the options.
    """
    by, limits = args.truth_by, given(args, "metres", "heading")
    if limits and by != "position":
        raise ValueError(f"--{next(iter(limits))} only goes with --truth-by position")
    if args.ground_truth is not None and by is not None:
        raise ValueError("--ground-truth and --truth-by both say what is true; give one of the two")
    if args.tolerance is None and args.ground_truth is None and by != "position":
        raise ValueError("give --tolerance N, the places to either side that count as right")


def truth_of(args: argparse.Namespace, reference: ImageFolder, query: ImageFolder) -> GroundTruth:
    """Which places of the map are true for the frames of the run."""
    by, tolerance = args.truth_by, args.tolerance
    if args.ground_truth is not None:
        return image_truth.from_file(args.ground_truth, reference, query, tolerance, args.trust)
    if by == "position":
        truth = image_truth.by_position(reference, query, **given(args, "metres", "heading"))
        return truth if tolerance is None else truth.with_tolerance(tolerance)
    if by == "name":
        return image_truth.by_name(reference, query, tolerance)
    return image_truth.by_index(reference, query, tolerance, exact=by is None)


def given(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Those of the options that were given, by name."""
    return {name: value for name in names if (value := getattr(args, name)) is not None}
