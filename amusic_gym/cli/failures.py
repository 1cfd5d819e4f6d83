"""Contact sheets of the failures of a comparison: camera, matched place and true place, as PNG.

The banks that were compared on must have been made of images, which are still where they were.
"""

import argparse
from functools import partial
from pathlib import Path

from amusic_gym.cli.options import MANY
from amusic_gym.cli.parser import Parser, destination
from amusic_gym.evaluation.failures import MOST, contact_sheets
from amusic_gym.utils.checks import whole


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("comparison", type=Path, metavar="DIR", help="the folder that compare wrote")
    add("--policy", metavar="POLICY", help="of these only, named as in results.json", **MANY)
    add("--most", type=int, default=MOST, metavar="N", help="on a sheet (default: %(default)s)")
    help_out = "for the sheets (default: DIR/failures)"
    parser.add_shared("--out", type=destination, required=False, metavar="FOLDER", help=help_out)


def main(args: argparse.Namespace) -> None:
    """Draw the sheets."""
    made = contact_sheets(
        args.comparison,
        args.out or args.comparison / "failures",
        policies=args.policy,
        most=whole("--most", args.most, 1),
        report=partial(print, flush=True),
    )
    print(f"\n{len(made)} sheets" + "".join(f"\n{path}" for path in made))
