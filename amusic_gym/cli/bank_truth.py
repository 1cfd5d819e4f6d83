"""What the commands that make banks are told of ground truth."""

import argparse
from typing import Any

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.cli.images import Traverse
from amusic_gym.cli.parser import Parser
from amusic_gym.routes import image_truth
from amusic_gym.routes.position_files import positions_of
from amusic_gym.routes.positions import Positions, from_names


def add_truth(parser: Parser) -> None:
    """Add the arguments that `check_truth` and `truth_of` read."""
    add = parser.add_argument
    add(
        "--truth-by",
        choices=("index", "name", "position"),
        help="frame q is at place q (index, the default where there are as many); at the image "
        "with the same name; or near images by their positions, which their names"
        " (@UTM_EAST@UTM_NORTH@) or the files of the next two options say",
    )
    parser.add_shared("--reference-positions", "--query-positions")
    near = f"how near, with --truth-by position (default: {image_truth.METRES:g})"
    add("--within", "--metres", dest="metres", type=float, metavar="METRES", help=near)
    add("--heading", type=float, metavar="D", help="likewise: seen within D degrees, too")
    parser.add_shared("--ground-truth", "--trust", "--tolerance", "--exclude-recent")


def check_truth(args: argparse.Namespace) -> None:
    """Refuse what contradicts itself, before any file is read."""
    positions = given(args, "reference_positions", "query_positions")
    if positions and args.truth_by is None and args.ground_truth is None:
        args.truth_by = "position"
    by = args.truth_by
    for name in given(args, "metres", "heading", "plot") if by != "position" else ():
        option = "within" if name == "metres" else name
        raise ValueError(f"--{option} only goes with --truth-by position")
    if args.ground_truth is not None and by is not None:
        raise ValueError("--ground-truth and --truth-by both say what is true; give one of the two")
    if args.tolerance is None and args.ground_truth is None and by != "position":
        raise ValueError("give --tolerance N, the places to either side that count as right")


def truth_of(
    args: argparse.Namespace, reference: Traverse, query: Traverse
) -> tuple[GroundTruth, tuple[Positions, Positions] | None]:
    """Which places of the map are true for the frames of the run, and the positions that say so."""
    by, tolerance, folders = args.truth_by, args.tolerance, (reference.folder, query.folder)
    if args.ground_truth is not None:
        return image_truth.from_file(args.ground_truth, *folders, tolerance, args.trust), None
    if by == "position":
        both = (
            _where(reference, args.reference_positions),
            _where(query, args.query_positions),
        )
        limits = given(args, "metres", "heading")
        truth = image_truth.by_position(*folders, positions=both, **limits)
        return truth if tolerance is None else truth.with_tolerance(tolerance), both
    if by == "name":
        return image_truth.by_name(*folders, tolerance), None
    return image_truth.by_index(*folders, tolerance, exact=by is None), None


def _where(traverse: Traverse, source: str | None) -> Positions:
    if traverse.positions is not None:
        return traverse.positions
    folder = traverse.folder
    return from_names(folder) if source is None else positions_of(source, folder)


def given(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Those of the options that were given, by name."""
    return {name: value for name in names if (value := getattr(args, name, None)) is not None}
