"""Measure estimated correctness p̂ against ground truth.

Of every technique run singly; and of the fused prediction under random activity, as recorded and
re-timed, with each technique's own statistic. Writes correctness.json, of the single techniques
reliability.png, of the random activity tables.md and reliability_random.png.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _cli import Parser, destination, run
from _random_activity import held_against_truth, random_drives, tables
from amusic_baselines import make_policy

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.evaluation import plots
from amusic_gym.evaluation.correctness import assess, table
from amusic_gym.evaluation.plots.drawing import GREY, figure_at
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context
from amusic_gym.policies.trace import Trace
from amusic_gym.utils.checks import whole
from amusic_gym.utils.storage import write_whole

COLOURS = ("#0072B2", "#D55E00")
MARKS = ("o", "s")
LEAST = 0.7  # frames at which the bars begin, on a logarithmic scale
FEW = 30  # bins of fewer frames are hollow: their share says little


def roll(bank: ScoreBank, statistic: str) -> list[Trace]:
    """One trace for each technique of a bank, run alone."""
    context = Context.of(bank, statistic=statistic)
    policies = [f"single:{name}" for name in bank.techniques]
    return [
        rollout(make_policy(policy, context), bank, name=policy, statistic=statistic)
        for policy in policies
    ]


def draw_reliability(
    curves: Mapping[str, Mapping[str, Sequence[Any]]], title: str, path: Path
) -> Path:
    """Draw share right against mean p̂; no intervals, as frames of one drive are not independent.

    ``curves``, two at most: name → ``predicted``, ``observed`` (None in empty bins) and ``counts``,
    each (B,).
    """
    with figure_at(path, 6.4, 7.0) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
        upper.plot([0, 1], [0, 1], color=GREY, linestyle="--", linewidth=1, label="perfect")
        for i, (name, curve) in enumerate(curves.items()):
            look: dict[str, Any] = {"color": COLOURS[i], "marker": MARKS[i]}
            counts = np.array(curve["counts"])
            points = np.array([curve["predicted"], curve["observed"]], float)  # (2, B), nan: empty
            upper.plot(*points[:, counts > 0], label=f"{name}, {counts.sum()} frames", **look)
            few = points[:, (counts > 0) & (counts < FEW)]
            upper.plot(*few, linestyle="none", markerfacecolor="white", **look)
            width = 0.8 / counts.size / len(curves)
            middles = (np.arange(counts.size) + 0.5) / counts.size
            aside = (i - (len(curves) - 1) / 2.0) * width
            bars = lower.bar(middles + aside, counts, width, color=COLOURS[i])
            words = [str(count or "") for count in counts]
            lower.bar_label(bars, words, padding=2, rotation=90, fontsize=7.5)
        upper.plot([], [], "o", color=GREY, markerfacecolor="white", label=f"under {FEW} frames")
        upper.set(ylabel="Share of frames that are right", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        upper.set_title(title)
        upper.legend(loc="upper left")
        upper.grid()
        most = max(10, *(max(curve["counts"]) for curve in curves.values()))
        lower.set_yscale("log")
        lower.set_ylim(LEAST, most * (most / LEAST) ** 0.4)  # room for the numbers over the bars
        lower.yaxis.set_major_formatter("{x:g}")
        lower.set(xlabel="Estimated correctness p̂", ylabel="Frames in the bin")
    return path


def main() -> None:
    """Parse the arguments, run the techniques, drive at random, report."""
    parser = Parser(description=__doc__)
    add = parser.add_argument
    add("--bank", nargs="+", action="extend", required=True, metavar="BANK", help="folders")
    add("--out", type=destination, required=True, metavar="DIR", help="the folder to write")
    own = "that places are found by (default: %(default)s)"
    add("--statistic", choices=STATISTICS, default=SICSettings.statistic, help=own)
    drives = (
        "random drives of each bank re-timed, seeds 0 to N-1, and as many as recorded; 0: one as "
        "recorded (default: %(default)s)"
    )
    add("--retimed", type=int, default=8, metavar="N", help=drives)
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
    report["random"] = held_against_truth(
        [list(random_drives(bank, args.statistic, retimed)) for bank in banks]
    )
    text = "\n\n".join(made.markdown() for made in tables(report["random"]))
    print(f"\n{text}")
    written = json.dumps(report, indent=1, allow_nan=False)
    write_whole(args.out / "correctness.json", written.encode() + b"\n")
    write_whole(args.out / "tables.md", text.encode() + b"\n")
    plots.reliability(traces, args.out / "reliability.png")
    title = f"Estimated correctness under random activity: {args.statistic}"
    draw_reliability(report["random"]["reliability"], title, args.out / "reliability_random.png")
    print(f"\n{args.out / 'correctness.json'}")


if __name__ == "__main__":
    run(main)
