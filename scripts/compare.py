"""Compare policies on score banks: a table, results.json, traces and figures.

POLICY: amusic (the paper's), amusic:evidence, amusic:belief, music, raw:NAME, single:NAME,
subset:A+B, random:P[/idle], periodic:N[/A+B[/C]] (C may be idle), cascade[:CHEAP/HOLD/THRESHOLD],
voi, voi:idle, voi:LAMBDA[/idle], oracle, ppo and ppo@belief (the selectors that ship, for evidence
and for belief), ppo:RUN (a folder that train.py wrote), mpf[:R], hmpf, dynmpf[:R], plurality,
borda[:DEPTH], hmm[:BETA/JUMP], switchhit[:TAU].
With idle nothing may run on a frame. Rows that are finished in DIR already are not run again.
"""

from __future__ import annotations

import argparse
from functools import partial

from _cli import Parser, add_correction, destination, insisted, run

from amusic_gym.banks.bank import COST_MODELS, ScoreBank
from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.evaluation.comparison import compare, draw, table
from amusic_gym.evaluation.contestants import (
    COMPUTE_WEIGHTS,
    MOST_TECHNIQUES,
    all_subsets,
    check_weights,
    contestants,
)


def specs(args: argparse.Namespace, bank: ScoreBank) -> list[str]:
    """The policies of the command line for one bank."""
    return [*args.policy, *(all_subsets(bank.techniques) if args.all_subsets else [])]


def _parser() -> Parser:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--bank", nargs="+", action="extend", required=True, metavar="BANK", help="folders")
    add("--policy", nargs="+", action="extend", metavar="POLICY", help="see above")
    add("--out", type=destination, required=True, metavar="DIR", help="the folder to write")
    add(
        "--all-subsets",
        action="store_true",
        help=f"add every subset of the techniques, of at most {MOST_TECHNIQUES}",
    )
    add(
        "--compute-weight",
        nargs="+",
        type=float,
        default=COMPUTE_WEIGHTS,
        metavar="L",
        help="run ppo, voi and voi:idle once with each λ (default: %(default)s)",
    )
    add(
        "--statistic",
        choices=STATISTICS,
        help="of SIC, for all policies but amusic and ppo, which bring their own "
        f"(default: {SICSettings.statistic})",
    )
    add_correction(parser, "for all policies but amusic and ppo")
    add("--costs", choices=COST_MODELS, help="cost model (default: the bank's own)")
    add("--seed", type=int, default=0, metavar="S", help="for policies that draw (default: 0)")
    return parser


def main() -> None:
    """Parse the arguments, compare, draw."""
    parser = _parser()
    args = parser.parse_args()
    args.policy = args.policy or []
    if not args.policy and not args.all_subsets:
        parser.error("no policy; give --policy, --all-subsets or both")
    weights = check_weights(args.compute_weight)
    banks = [ScoreBank.load(folder, verify=True) for folder in args.bank]
    if args.costs:
        banks = [bank.with_costs(args.costs) for bank in banks]
    result = compare(
        banks,
        lambda bank: contestants(specs(args, bank), compute_weights=weights, **insisted(args)),
        args.out,
        statistic=args.statistic or SICSettings.statistic,
        carry=args.carry,
        discount=args.discount,
        seed=args.seed,
        report=partial(print, flush=True),
    )
    draw(result, args.out)
    print(f"\n{table(result)}\n\n{args.out / 'results.json'}")


if __name__ == "__main__":
    run(main)
