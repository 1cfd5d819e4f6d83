"""Measure estimated correctness p̂ against ground truth.

Of every technique run singly; and of the fused prediction under random activity, as recorded and
re-timed, with each technique's own statistic. Writes correctness.json, of the single techniques
reliability.png, of the random activity tables.md and reliability_random.png.
"""

import json
from itertools import chain
from typing import Any

from _cli import Parser, destination, run
from _random_activity import BINS, by_timing, held_against_truth, random_drives, tables
from amusic_baselines import make_policy

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.evaluation import plots
from amusic_gym.evaluation.correctness import assess, table
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context
from amusic_gym.policies.trace import Trace
from amusic_gym.utils.checks import whole
from amusic_gym.utils.storage import write_whole


def roll(bank: ScoreBank, statistic: str) -> list[Trace]:
    """One trace for each technique of a bank, run alone."""
    context = Context.of(bank, statistic=statistic)
    policies = [f"single:{name}" for name in bank.techniques]
    return [
        rollout(make_policy(policy, context), bank, name=policy, statistic=statistic)
        for policy in policies
    ]


def main() -> None:
    """Parse the arguments, run the techniques, drive at random, report."""
    parser = Parser(description=__doc__)
    add = parser.add_argument
    add("--bank", nargs="+", action="extend", required=True, metavar="BANK", help="folders")
    add("--out", type=destination, required=True, metavar="DIR", help="the folder to write")
    own = "that places are found by (default: %(default)s)"
    add("--statistic", choices=STATISTICS, default=SICSettings.statistic, help=own)
    how_many = (
        "random drives of each bank re-timed, seeds 0 to N-1, and as many as recorded; 0: one as "
        "recorded (default: %(default)s)"
    )
    add("--retimed", type=int, default=8, metavar="N", help=how_many)
    args = parser.parse_args()
    retimed = whole("--retimed", args.retimed, 0)
    banks = [ScoreBank.load(folder) for folder in args.bank]
    traces = [trace for bank in banks for trace in roll(bank, args.statistic)]
    report: dict[str, Any] = {"statistic": args.statistic, **assess(traces)}
    print(table(report))
    within = report["within"]
    if within["auroc"] is not None:
        print(
            f"\nwithin techniques: mean AUROC {within['auroc']:.4f}, least "
            f"{within['least_auroc']:.4f}, of {within['techniques']} that are sometimes wrong"
        )
    drives = [list(random_drives(bank, args.statistic, retimed)) for bank in banks]
    report["random"] = held_against_truth(drives)
    text = "\n\n".join(made.markdown() for made in tables(report["random"]))
    print(f"\n{text}")
    written = json.dumps(report, indent=1, allow_nan=False)
    write_whole(args.out / "correctness.json", written.encode() + b"\n")
    write_whole(args.out / "tables.md", text.encode() + b"\n")
    plots.reliability({"each technique alone": traces}, args.out / "reliability.png")
    groups = {
        timing: [drive.trace for drive in group]
        for timing, group in by_timing(chain.from_iterable(drives)).items()
    }
    title = f"Estimated correctness under random activity: {args.statistic}"
    plots.reliability(groups, args.out / "reliability_random.png", title=title, bins=BINS)
    print(f"\n{args.out / 'correctness.json'}")


if __name__ == "__main__":
    run(main)
