"""Study policies on score banks: as recorded and re-timed, over seeds and λ; it may take hours.

POLICY: as in compare.py; POLICY@STATISTIC runs one under another statistic, for an ablation. Seed
s re-times every bank in its own way, is the seed of policies that draw, and the s-th run of a
--selector. Every finished cell is kept in DIR/cells: after Ctrl-C or a kill the same command goes
on where it was, and a longer one computes only what is new or changed. Writes DIR/study.json,
tables.md and the figures.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from _cli import Parser, add_correction, destination, insisted, pairs, run

from amusic_gym.banks.bank import COST_MODELS, ScoreBank
from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.evaluation import study
from amusic_gym.evaluation.contestants import COMPUTE_WEIGHTS, MOST_TECHNIQUES, check_weights
from amusic_gym.evaluation.study.figures import draw
from amusic_gym.evaluation.study.lineup import Lineup
from amusic_gym.evaluation.study.tables import text, write_markdown
from amusic_gym.extraction.executors import make_executor


def _parser() -> Parser:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--bank", nargs="+", action="extend", required=True, metavar="BANK", help="folders")
    add("--out", type=destination, required=True, metavar="DIR", help="the folder to write")
    _add_policies(parser)
    add("--costs", choices=COST_MODELS, help="cost model (default: the bank's own)")
    add(
        "--seeds",
        type=int,
        default=study.SEED_COUNT,
        metavar="N",
        help="how many (default: %(default)s)",
    )
    add("--first-seed", type=int, default=0, metavar="S", help="the first of them (default: 0)")
    add(
        "--conditions",
        nargs="+",
        choices=study.CONDITIONS,
        default=study.CONDITIONS,
        help="(default: both)",
    )
    add(
        "--executor",
        default="serial",
        metavar="E",
        help="serial, process:N, ray or ray:ADDRESS (default: serial)",
    )
    add("--dry-run", action="store_true", help="only count the cells and those that are finished")
    return parser


def _add_policies(parser: Parser) -> None:
    add = parser.add_argument
    add("--policy", nargs="+", action="extend", default=[], metavar="POLICY", help="see above")
    add(
        "--all-subsets",
        action="store_true",
        help=f"add every subset of the techniques, of at most {MOST_TECHNIQUES}",
    )
    add(
        "--selector",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=RUN,RUN...",
        help="runs of one training with different seeds, as many as --seeds, or one",
    )
    add(
        "--rival",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="selectors that the others must beat, besides fixed subsets and rules "
        "(default: those whose names begin with 'imitation')",
    )
    add(
        "--compute-weight",
        nargs="+",
        type=float,
        default=COMPUTE_WEIGHTS,
        metavar="L",
        help=f"λ of the selectors and of voi, at most {study.MOST_WEIGHTS} (default: %(default)s)",
    )
    add(
        "--statistic",
        choices=STATISTICS,
        help="of SIC, for all policies but amusic and trained ones, which bring their own "
        f"(default: {SICSettings.statistic})",
    )
    add_correction(parser, "for all policies but amusic and trained ones")


def lineup(args: argparse.Namespace) -> Lineup:
    """The policies of the command line."""
    selectors = {
        name: tuple(f"ppo:{run}" for run in runs.split(","))
        for name, runs in pairs(args.selector, "--selector").items()
    }
    return Lineup(
        policies=tuple(args.policy),
        selectors=selectors,
        all_subsets=args.all_subsets,
        insisted=insisted(args),
        compute_weights=check_weights(args.compute_weight),
    )


def rivals(args: argparse.Namespace, selectors: Lineup) -> list[str]:
    """The learned selectors that the others must beat."""
    learned = [*selectors.selectors, *selectors.policies]
    if args.rival is None:
        return [name for name in learned if name.startswith("imitation")]
    for name in args.rival:
        if name not in learned:
            raise ValueError(f"--rival {name!r} is no selector of this study; name it as there")
    return list(args.rival)


def seeds(args: argparse.Namespace) -> range:
    """The seeds of the command line."""
    if args.seeds < 1 or args.first_seed < 0:
        raise ValueError(
            f"--seeds is {args.seeds} and --first-seed {args.first_seed}; give at least 1 seed, "
            "the first >= 0"
        )
    return range(args.first_seed, args.first_seed + args.seeds)


def count(plan: study.Plan, out: Path) -> None:
    """Print how many cells there are, and how many are finished."""
    counts = study.count_finished(plan, out)
    width = max(map(len, counts))
    for name, (have, cells) in counts.items():
        print(f"{name:<{width}}  {have:>5} of {cells:>5} cells finished")
    done, total = (sum(column) for column in zip(*counts.values(), strict=True))
    print(f"{done} of {total} cells finished, {total - done} to compute")


def main() -> None:
    """Parse the arguments, run what is not finished, write what came out."""
    parser = _parser()
    args = parser.parse_args()
    if not (args.policy or args.all_subsets or args.selector):
        parser.error("no policy; give --policy, --all-subsets or --selector")
    policies = lineup(args)
    beaten = rivals(args, policies)
    make_executor(args.executor)  # refuses a wrong name before anything is read
    banks = [ScoreBank.load(folder, verify=True) for folder in args.bank]
    if args.costs:
        banks = [bank.with_costs(args.costs) for bank in banks]
    plan = study.make_plan(
        banks,
        lambda bank: policies.entrants(bank.techniques),
        statistic=args.statistic or SICSettings.statistic,
        carry=args.carry,
        discount=args.discount,
        seeds=seeds(args),
        conditions=args.conditions,
    )
    if args.dry_run:
        count(plan, args.out)
        return
    say = partial(print, flush=True)
    finished = study.run(plan, args.out, executor=args.executor, report=say)
    findings = study.find(plan, finished, rivals=beaten)
    findings.write(args.out)
    write_markdown(findings, args.out)
    draw(findings, args.out)
    print(f"\n{text(findings)}\n\n{args.out / 'study.json'}")


if __name__ == "__main__":
    run(main)
