"""Compare policies on score banks: a table, results.json, traces, figures and a page.

POLICY: amusic (the paper's), amusic:evidence, amusic:belief, music, raw:NAME, single:NAME,
subset:A+B, random:P[/idle], periodic:N[/A+B[/C]] (C may be idle), cascade[:CHEAP/HOLD/THRESHOLD],
voi, voi:idle, voi:LAMBDA[/idle], oracle, ppo and ppo@belief (the selectors that ship, for evidence
and for belief), ppo:RUN (a folder that train wrote), mpf[:R], hmpf, dynmpf[:R], plurality,
borda[:DEPTH], hmm[:BETA/JUMP], switchhit[:TAU].
With idle nothing may run on a frame. Rows that are finished in DIR already are not run again.
"""

import argparse
from functools import partial

from amusic_gym.cli.parser import Parser, correction_of, insisted
from amusic_gym.cli.policies import add_policies, banks_of
from amusic_gym.evaluation.comparison import compare, table
from amusic_gym.evaluation.contestants import all_subsets, check_weights, contestants
from amusic_gym.evaluation.figures import write_page


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_policies(parser, "for all policies but amusic and ppo, which bring their own")
    parser.add_shared("--seed")
    lists = "also write each query's K best places to DIR/lists"
    parser.add_argument("--top-k", type=int, metavar="K", help=lists)


def main(args: argparse.Namespace) -> None:
    """Compare, draw."""
    if not args.policy and not args.all_subsets:
        args.parser.error("no policy; give --policy, --all-subsets or both")
    weights = check_weights(args.compute_weight)
    result = compare(
        banks_of(args),
        lambda bank: contestants(
            [*args.policy, *(all_subsets(bank.techniques) if args.all_subsets else [])],
            compute_weights=weights,
            **insisted(args),
        ),
        args.out,
        **correction_of(args),
        seed=args.seed,
        top=args.top_k,
        report=partial(print, flush=True),
    )
    page = write_page(result, args.out)
    print(f"\n{table(result)}\n\n{args.out / 'results.json'}\n{page}")
