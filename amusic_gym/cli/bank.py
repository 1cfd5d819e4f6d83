"""Make and inspect banks.

arrays | descriptors | vprbench | images | tour | simulate | retime | info; render | describe.
"""

import argparse
from pathlib import Path

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.bank_files import check_destination
from amusic_gym.cli.bank_descriptors import add_describe, add_descriptors, describe, descriptors
from amusic_gym.cli.bank_images import add_images, add_render, add_tour, images, render, tour
from amusic_gym.cli.bank_truth import given
from amusic_gym.cli.images import tell
from amusic_gym.cli.options import MANY
from amusic_gym.cli.parser import Parser, add_commands, numbers, pairs


def arrays(args: argparse.Namespace) -> None:
    """One .npy matrix per technique -> a bank."""
    from amusic_gym.banks.importers import from_arrays

    check_destination(args.out)
    bank = from_arrays(
        pairs(args.scores, "--scores"),
        numbers(pairs(args.seconds, "--seconds"), "--seconds"),
        tolerance=args.tolerance,
        ground_truth=args.ground_truth,
        name=args.name or args.out.name,
        exclude_recent=args.exclude_recent,
        out=args.out,
    )
    tell(args.out.resolve(), bank.shape)


def vprbench(args: argparse.Namespace) -> None:
    """VPR-Bench's precomputed matches -> a bank."""
    from amusic_gym.banks.importers import from_vprbench

    bank = from_vprbench(
        args.matches,
        args.techniques.split(","),
        args.ground_truth,
        args.trust,
        tolerance=args.tolerance,
        name=args.name or args.out.name,
    )
    tell(bank.save(args.out), bank.shape)


def simulate(args: argparse.Namespace) -> None:
    """A simulated route -> a bank."""
    from amusic_gym.routes.simulate import simulate

    options = given(args, "queries", "references", "techniques", "motion")
    bank = simulate(args.seed, **options)
    tell(bank.save(args.out), bank.shape)


def retime(args: argparse.Namespace) -> None:
    """A recording, driven through with stops and other speeds, and with jumps -> a bank."""
    from amusic_gym.routes.retime import save_retimed

    # Verified: else the new checksum would vouch for damaged scores.
    bank = ScoreBank.load(args.bank, verify=True)
    tell(save_retimed(bank, args.seed, args.out, args.motion, name=args.name or ""), bank.shape)


def info(args: argparse.Namespace) -> None:
    """Check a bank whole and print what is in it."""
    bank = ScoreBank.load(args.bank, verify=True)
    bank.check_finite()
    print(f"bank        {bank.name}  ({bank.path})")
    print(f"source      {bank.source or '-'}")
    print(f"queries     {bank.queries}, {int(bank.truth.has_place.sum())} with a true place")
    print(f"references  {bank.references}")
    print(f"tolerance   {bank.tolerance} places")
    print(f"costs       {bank.costs}")
    print(f"\n{'technique':<20} {'seconds':>12} {'raw accuracy':>12}")
    for technique, name in enumerate(bank.techniques):
        best = [int(bank.row(technique, query).argmax()) for query in range(bank.queries)]
        accuracy = bank.truth.correct(best).mean()
        print(f"{name:<20} {bank.seconds[technique]:>12.6f} {accuracy:>12.4f}")


def add_arguments(parser: Parser) -> None:
    """Add the commands, and the arguments of each."""
    add_commands(
        parser,
        (arrays, _add_arrays, "from one .npy matrix of scores per technique"),
        (descriptors, add_descriptors, "from global descriptors, hloc's and others'"),
        (vprbench, _add_vprbench, "from VPR-Bench's precomputed matches"),
        (images, add_images, "from two folders of images, or a data set by name"),
        (tour, add_tour, "from image folders: one drive under changing conditions"),
        (simulate, _add_simulate, "from the route simulator"),
        (retime, _add_retime, "from a bank: its frames as seen with stops, speeds and jumps"),
        (render, add_render, "draw a made-up route in any weather, as folders of images"),
        (describe, add_describe, "write descriptors of images, and similar pairs, as hloc does"),
        (info, _add_info, "check a bank and print what is in it"),
    )


def _add_arrays(parser: Parser) -> None:
    what = "[query, reference] scores, higher = more similar"
    parser.add_argument("--scores", required=True, metavar="NAME=FILE.npy", help=what, **MANY)
    parser.add_shared("--seconds", required=True, help="seconds of one run on one frame")
    parser.add_shared("--ground-truth", "--tolerance", "--exclude-recent", "--name", "--out")


def _add_vprbench(parser: Parser) -> None:
    parser.add_argument("--matches", type=Path, required=True, metavar="DIR", help="their folder")
    parser.add_shared("--techniques", required=True, help="which, in this order")
    parser.add_shared("--ground-truth", required=True)
    parser.add_shared("--trust", "--tolerance", "--name", "--out")


def _add_simulate(parser: Parser) -> None:
    add = parser.add_argument
    parser.add_shared("--seed", required=True)
    add("--queries", type=int, metavar="Q", help="frames of the route")
    add("--references", type=int, metavar="R", help="places on the map")
    add("--techniques", type=int, metavar="T", help="how many techniques")
    motions = "1:1 (recorded, the default); stops and other speeds; jumps besides"
    add("--motion", metavar="recorded|paced|kidnapped", help=motions)
    parser.add_shared("--out")


def _add_retime(parser: Parser) -> None:
    add = parser.add_argument
    add("bank", type=Path, metavar="BANK", help="the recording")
    motions = "stops and other speeds; jumps besides (default: %(default)s)"
    add("--motion", default="kidnapped", metavar="paced|kidnapped", help=motions)
    parser.add_shared("--seed", required=True, help="of the motion")
    parser.add_shared("--name", "--out")


def _add_info(parser: Parser) -> None:
    parser.add_argument("bank", type=Path, metavar="BANK", help="its folder")
