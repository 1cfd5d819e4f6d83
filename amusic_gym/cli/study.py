"""Study policies on score banks, over motions, seeds and λ; it may take hours.

POLICY: as compare takes them; POLICY@STATISTIC runs one under another statistic, for an ablation.
Seed s moves along every bank in its own way, is the seed of policies that draw, and the s-th run of
a --selector. Every finished cell is kept in DIR/cells: after Ctrl-C or a kill the same command goes
on where it was, and a longer one computes only what is new or changed. Writes DIR/study.json,
tables.md, the figures and a page, index.html.
"""

import argparse
from functools import partial
from pathlib import Path

from amusic_gym.cli.options import MANY
from amusic_gym.cli.parser import Parser, correction_of, insisted, pairs
from amusic_gym.cli.policies import add_policies, banks_of
from amusic_gym.evaluation import study
from amusic_gym.evaluation.contestants import check_weights
from amusic_gym.evaluation.study.lineup import Lineup
from amusic_gym.evaluation.study.page import write_page
from amusic_gym.evaluation.study.tables import text, write_markdown
from amusic_gym.extraction.executors import make_executor


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    whose = "for all policies but amusic and trained ones, which bring their own"
    add_policies(parser, whose, f", at most {study.MOST_WEIGHTS}")
    add = parser.add_argument
    runs = "runs of one training with different seeds, as many as --seeds, or one"
    add("--selector", metavar="NAME=RUN,RUN...", help=runs, **MANY)
    beaten = (
        "selectors that the others must beat, besides fixed subsets and rules (default: those"
        " whose names begin with 'imitation')"
    )
    add("--rival", metavar="NAME", help=beaten, **{**MANY, "default": None})
    add("--seeds", type=int, default=study.SEED_COUNT, metavar="N", help="(default: %(default)s)")
    add("--first-seed", type=int, default=0, metavar="S", help="the first of them (default: 0)")
    kinds = study.CONDITIONS
    add("--conditions", nargs="+", choices=kinds, default=kinds, help="motions (default: all)")
    parser.add_shared("--executor")
    add("--dry-run", action="store_true", help="only count the cells and those that are finished")


def main(args: argparse.Namespace) -> None:
    """Run what is not finished, write what came out."""
    if not (args.policy or args.all_subsets or args.selector):
        args.parser.error("no policy; give --policy, --all-subsets or --selector")
    policies = _lineup(args)
    beaten = _rivals(args, policies)
    make_executor(args.executor)  # refuses a wrong name before anything is read
    plan = study.make_plan(
        banks_of(args),
        lambda bank: policies.entrants(bank.techniques),
        **correction_of(args),
        seeds=_seeds(args),
        conditions=args.conditions,
    )
    if args.dry_run:
        _count(plan, args.out)
        return
    say = partial(print, flush=True)
    finished = study.run(plan, args.out, executor=args.executor, report=say)
    findings = study.find(plan, finished, rivals=beaten)
    findings.write(args.out)
    write_markdown(findings, args.out)
    page = write_page(findings, args.out)
    print(f"\n{text(findings)}\n\n{args.out / 'study.json'}\n{page}")


def _lineup(args: argparse.Namespace) -> Lineup:
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


def _rivals(args: argparse.Namespace, policies: Lineup) -> list[str]:
    """The learned selectors that the others must beat."""
    learned = [*policies.selectors, *policies.policies]
    if args.rival is None:
        return [name for name in learned if name.startswith("imitation")]
    for name in args.rival:
        if name not in learned:
            raise ValueError(f"--rival {name!r} is no selector of this study; name it as there")
    return list(args.rival)


def _seeds(args: argparse.Namespace) -> range:
    if args.seeds < 1 or args.first_seed < 0:
        raise ValueError(
            f"--seeds is {args.seeds} and --first-seed {args.first_seed}; give at least 1 seed, "
            "the first >= 0"
        )
    return range(args.first_seed, args.first_seed + args.seeds)


def _count(plan: study.Plan, out: Path) -> None:
    counts = study.count_finished(plan, out)
    width = max(map(len, counts))
    for name, (have, cells) in counts.items():
        print(f"{name:<{width}}  {have:>5} of {cells:>5} cells finished")
    done, total = (sum(column) for column in zip(*counts.values(), strict=True))
    print(f"{done} of {total} cells finished, {total - done} to compute")
