"""The part of bank.py that joins image routes into one drive: tour."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from _bank_extract import Techniques, add_extraction, extract_bank
from _cli import Parser

if TYPE_CHECKING:
    from amusic_gym.routes.folders import ImageFolder

_PART = re.compile(r"([^:]+):([^:]+?)(?:@(\d+):(\d+):([1-9]\d*))?")


def tour(args: argparse.Namespace) -> None:
    """Several pairs of image folders, one drive under changing conditions -> a bank."""
    from amusic_gym.banks.bank_files import check_destination
    from amusic_gym.extraction.progress import Progress
    from amusic_gym.routes import tours
    from amusic_gym.routes.conditions import CONDITIONS

    parts = [_part(text) for text in args.part]
    chosen = CONDITIONS if args.conditions is None else args.conditions.split(",")
    made = tours.make_tour(parts, list(chosen), seed=args.seed)
    truth = made.ground_truth(args.tolerance)
    techniques = Techniques.of(args)
    check_destination(args.out)
    if args.images is not None:
        tours.check_destination(args.images)
        total = len(made.reference) + len(made.query)
        with Progress(True).bar("tour", total, "images") as advance:
            print(f"{tours.write_tour(made, args.images, advance)}: {total} images")
    extract_bank(
        args,
        techniques,
        made.reference,
        made.query,
        tolerance=args.tolerance,
        ground_truth=truth,
        name=args.name or "",
        source=made.source,
    )
    for spell in made.spells:
        print(f"from frame {spell.first}: {spell.condition}")


def add_tour(commands: Any) -> Parser:
    """The command ``tour``."""
    parser: Parser = commands.add_parser(
        "tour", help="from several pairs of image folders: one drive under changing conditions"
    )
    parser.set_defaults(run=tour)
    add = parser.add_argument
    add(
        "--part",
        nargs="+",
        action="extend",
        required=True,
        metavar="REFERENCE:QUERY[@FIRST:STOP:STEP]",
        help="two folders with as many images each; frame q is at place q; of both, images FIRST, "
        "FIRST + STEP, … before STOP, or all",
    )
    add(
        "--conditions",
        metavar="A,B",
        help="of the query, a spell of 40 to 80 frames each: plain, night, blur, shift, fog, rain, "
        "glare (default: all); NAME:STRENGTH, above 0 and up to 1, and A+B for both at once",
    )
    add("--seed", type=int, default=0, metavar="S", help="of the conditions (default: 0)")
    add(
        "--images",
        type=Path,
        metavar="DIR",
        help="write the images, too, as DIR/reference and DIR/query",
    )
    add_extraction(parser, tolerance_required=True, name="--out's name")
    return parser


def _part(text: str) -> tuple[ImageFolder, ImageFolder]:
    """``REFERENCE:QUERY`` or ``REFERENCE:QUERY@FIRST:STOP:STEP``, cut as Python cuts a list."""
    from amusic_gym.routes.folders import ImageFolder

    found = _PART.fullmatch(text)
    if found is None:
        raise ValueError(
            f"--part {text!r} is not of the form REFERENCE:QUERY or "
            "REFERENCE:QUERY@FIRST:STOP:STEP, two folders with one colon between them"
        )
    reference, query, first, stop, step = found.groups()
    if first is None:
        return ImageFolder(reference), ImageFolder(query)
    taken = range(int(first), int(stop), int(step))
    if not taken:
        raise ValueError(f"--part {text!r} takes no image; give a STOP above FIRST")
    cut: dict[str, Any] = {"first": taken.start, "step": taken.step, "count": len(taken)}
    return ImageFolder(reference, **cut), ImageFolder(query, **cut)
