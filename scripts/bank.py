"""Make and inspect banks: arrays | vprbench | images | tour | simulate | retime | info; render."""

from __future__ import annotations

import argparse
from pathlib import Path

from _bank_images import add_images, add_render
from _bank_tour import add_tour
from _cli import Parser, number, pairs, run

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.bank_files import check_destination
from amusic_gym.banks.importers import from_arrays, from_vprbench


def arrays(args: argparse.Namespace) -> None:
    """One .npy matrix per technique -> a bank."""
    check_destination(args.out)
    bank = from_arrays(
        pairs(args.scores, "--scores"),
        {
            name: number(f"--seconds {name}", text)
            for name, text in pairs(args.seconds, "--seconds").items()
        },
        tolerance=args.tolerance,
        ground_truth=args.ground_truth,
        name=args.name or args.out.name,
        exclude_recent=args.exclude_recent,
        out=args.out,
    )
    _tell(args.out.resolve(), bank.shape)


def vprbench(args: argparse.Namespace) -> None:
    """VPR-Bench's precomputed matches -> a bank."""
    bank = from_vprbench(
        args.matches,
        args.techniques.split(","),
        args.ground_truth,
        args.trust,
        tolerance=args.tolerance,
        name=args.name or args.out.name,
    )
    _save(bank, args.out)


def simulate(args: argparse.Namespace) -> None:
    """A simulated route -> a bank."""
    from amusic_gym.routes.simulate import simulate

    given = {
        option: value
        for option in ("queries", "references", "techniques", "motion")
        if (value := getattr(args, option)) is not None
    }
    _save(simulate(args.seed, **given), args.out)


def retime(args: argparse.Namespace) -> None:
    """A recording, driven through with stops and other speeds, and with jumps -> a bank."""
    from amusic_gym.routes.retime import save_retimed

    # Verified: else the new checksum would vouch for damaged scores.
    bank = ScoreBank.load(args.bank, verify=True)
    path = save_retimed(bank, args.seed, args.out, args.motion, name=args.name or "")
    _tell(path, bank.shape)


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


def _save(bank: ScoreBank, out: Path) -> None:
    _tell(bank.save(out), bank.shape)


def _tell(path: Path, shape: tuple[int, int, int]) -> None:
    techniques, queries, references = shape
    print(f"{path}: {techniques} techniques, {queries} queries, {references} references")


def _parser() -> Parser:
    parser = Parser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    one = commands.add_parser("arrays", help="from one .npy matrix of scores per technique")
    one.set_defaults(run=arrays)
    one.add_argument(
        "--scores",
        nargs="+",
        action="extend",
        required=True,
        metavar="NAME=FILE.npy",
        help="[query, reference] scores, higher = more similar",
    )
    one.add_argument(
        "--seconds",
        nargs="+",
        action="extend",
        required=True,
        metavar="NAME=S",
        help="seconds of one run on one frame",
    )
    one.add_argument(
        "--ground-truth",
        type=Path,
        metavar="FILE",
        help=".npy or text: boolean [query, reference], one true place per query (-1: none), or "
        "pairs below 'query,place'; without it, query q is at place q",
    )

    one.add_argument(
        "--exclude-recent",
        type=int,
        metavar="N",
        help="one sequence against itself (loop closure): the N frames before each, itself and "
        "those after it are no candidates",
    )

    two = commands.add_parser("vprbench", help="from VPR-Bench's precomputed matches")
    two.set_defaults(run=vprbench)
    two.add_argument("--matches", type=Path, required=True, metavar="DIR")
    two.add_argument("--techniques", required=True, metavar="A,B", help="which, in this order")
    two.add_argument("--ground-truth", type=Path, required=True, metavar="FILE.npy")
    two.add_argument(
        "--trust",
        action="store_true",
        help="unpickle these files: a pickle can run any code, so only from whom you trust",
    )

    for each in (one, two):
        each.add_argument(
            "--tolerance",
            type=int,
            metavar="N",
            help="places to either side of the true one that count as right; not where the ground "
            "truth lists them itself",
        )
        each.add_argument("--name", help="what to call it in tables (default: --out's name)")

    three = commands.add_parser("simulate", help="from the route simulator")
    three.set_defaults(run=simulate)
    three.add_argument("--seed", type=int, required=True, metavar="S")
    three.add_argument("--queries", type=int, metavar="Q", help="frames of the route")
    three.add_argument("--references", type=int, metavar="R", help="places on the map")
    three.add_argument("--techniques", type=int, metavar="T", help="how many techniques")
    three.add_argument(
        "--motion",
        metavar="recorded|paced|kidnapped",
        help="1:1 (recorded, the default); stops and other speeds; jumps besides",
    )

    four = commands.add_parser(
        "retime", help="from a bank: its frames as seen with stops, speeds and jumps"
    )
    four.set_defaults(run=retime)
    four.add_argument("bank", type=Path, metavar="BANK", help="the recording")
    four.add_argument(
        "--motion",
        default="kidnapped",
        metavar="paced|kidnapped",
        help="stops and other speeds; jumps besides (default: %(default)s)",
    )
    four.add_argument("--seed", type=int, required=True, metavar="S", help="of the motion")
    four.add_argument(
        "--name", help="what to call it in tables (default: BANK's, the motion and the seed)"
    )

    for each in (one, two, three, four):
        each.add_argument("--out", type=Path, required=True, metavar="BANK", help="the folder")

    add_images(commands)
    add_tour(commands)
    add_render(commands)

    five = commands.add_parser("info", help="check a bank and print what is in it")
    five.set_defaults(run=info)
    five.add_argument("bank", type=Path, metavar="BANK")
    return parser


def main() -> None:
    """Parse the arguments and run the command."""
    args = _parser().parse_args()
    args.run(args)


if __name__ == "__main__":
    run(main)
