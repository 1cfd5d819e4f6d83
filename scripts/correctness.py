"""Measure estimated correctness against ground truth, every technique run singly.

Writes correctness.json and the reliability diagram reliability.png.
"""

from __future__ import annotations

import json
from pathlib import Path

from _cli import Parser, run

from amusic_gym import plots
from amusic_gym.bank import ScoreBank
from amusic_gym.correctness import assess, table
from amusic_gym.policy import Context
from amusic_gym.rollout import rollout
from amusic_gym.settings import STATISTICS, SICSettings
from amusic_gym.trace import Trace, write_whole
from baselines import make_policy


def roll(bank: ScoreBank, statistic: str) -> list[Trace]:
    """One trace for each technique of a bank, run alone."""
    context = Context.of(bank, statistic=statistic)
    policies = [f"single:{name}" for name in bank.techniques]
    return [
        rollout(make_policy(policy, context), bank, name=policy, statistic=statistic)
        for policy in policies
    ]


def _parser() -> Parser:
    parser = Parser(description=__doc__)
    add = parser.add_argument
    add("--bank", nargs="+", action="extend", required=True, metavar="BANK", help="folders")
    add("--out", type=Path, required=True, metavar="DIR", help="the folder to write")
    add(
        "--statistic",
        choices=STATISTICS,
        default=SICSettings.statistic,
        help="that places are found by (default: %(default)s)",
    )
    return parser


def main() -> None:
    """Parse the arguments, run the techniques, report."""
    args = _parser().parse_args()
    banks = [ScoreBank.load(folder) for folder in args.bank]
    traces = [trace for bank in banks for trace in roll(bank, args.statistic)]
    report = {"statistic": args.statistic, **assess(traces)}
    write_whole(
        args.out / "correctness.json",
        json.dumps(report, indent=1, allow_nan=False).encode() + b"\n",
    )
    plots.reliability(traces, args.out / "reliability.png")
    print(table(report))
    within = report["within"]
    if within["auroc"] is not None:
        print(
            f"\nwithin techniques: mean AUROC {within['auroc']:.4f}, least "
            f"{within['least_auroc']:.4f}, of {within['techniques']} that are sometimes wrong"
        )
    print(f"\n{args.out / 'correctness.json'}")


if __name__ == "__main__":
    run(main)
