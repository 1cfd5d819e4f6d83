"""Arguments of the commands that run policies on banks: compare | study."""

import argparse

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.costs import COST_MODELS
from amusic_gym.cli.options import MANY
from amusic_gym.cli.parser import Parser, add_statistic, page_folder
from amusic_gym.evaluation.contestants import COMPUTE_WEIGHTS, MOST_TECHNIQUES


def add_policies(parser: Parser, whose: str, most_weights: str = "") -> None:
    """Add the banks, the policies and how they are run."""
    parser.add_shared("--bank", required=True)
    parser.add_shared("--policy", **MANY)
    parser.add_shared("--out", type=page_folder, metavar="DIR")
    subsets = f"add every subset of the techniques, of at most {MOST_TECHNIQUES}"
    parser.add_argument("--all-subsets", action="store_true", help=subsets)
    weights = f"λ of the selectors and of voi{most_weights} (default: %(default)s)"
    parser.add_shared("--compute-weight", default=COMPUTE_WEIGHTS, help=weights)
    add_statistic(parser, whose)
    parser.add_shared("--costs", choices=COST_MODELS)


def banks_of(args: argparse.Namespace) -> list[ScoreBank]:
    """The banks of ``--bank``, whole, with the costs of ``--costs``."""
    banks = [ScoreBank.load(folder, verify=True) for folder in args.bank]
    return [bank.with_costs(args.costs) if args.costs else bank for bank in banks]
