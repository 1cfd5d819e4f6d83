"""Measure estimated correctness p̂ against ground truth.

Of every technique run singly; and of the fused prediction under random activity, as recorded and
re-timed. Writes correctness.json, of the single techniques reliability.png, of the random activity
tables.md and reliability_random.png.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from _cli import Parser, destination, run
from _drives import drive

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.evaluation import metrics, plots
from amusic_gym.evaluation.audit import audit, held
from amusic_gym.evaluation.correctness import assess, table
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.trace import Trace
from amusic_gym.routes.retime import retime
from amusic_gym.utils.checks import whole
from amusic_gym.utils.storage import write_whole

RATES = (0.1, 0.3, 0.6, 1.0)
"""With one of these chances, drawn for the whole drive, each technique runs on each frame."""

BINS = 10  # of the calibration error and of the figure
SURE = 0.9  # a place of this p̂ or more is one that somebody may act on

RECORDED, RETIMED = "as recorded", "re-timed"

Groups = Mapping[str, Sequence[Trace]]
"""Drives by their timing: `RECORDED`, `RETIMED`."""


def random_drives(bank: ScoreBank, statistic: str, retimed: int) -> Groups:
    """A bank as recorded, then re-timed with the seeds from 0, so many of each, at least one.

    A re-timed drive has the activity of the recorded one of the same number.
    """
    rates = [np.random.default_rng([seed, 1]).choice(RATES) for seed in range(max(1, retimed))]
    runs = [(f"random:{rate}", seed) for seed, rate in enumerate(rates)]
    groups = {RECORDED: [drive(spec, bank, statistic, seed) for spec, seed in runs]}
    if retimed:
        groups[RETIMED] = [drive(spec, retime(bank, seed), statistic, seed) for spec, seed in runs]
    return groups


def held_against_truth(banks: Sequence[tuple[str, Groups]]) -> dict[str, Any]:
    """What the drives of banks, each with its name, show: per bank and pooled.

    Returns:
        ``{"fused": [...], "reliability": {timing: ...}}``, plain values that ``json.dump`` takes;
        the reliability is that of all banks, None in empty bins.
    """
    pooled = pool(banks)
    fused = [
        {"bank": name, "timing": timing, **_fused(traces)}
        for name, groups in (*banks, ("pooled", pooled))
        for timing, traces in groups.items()
    ]
    curves = {timing: _curve(traces) for timing, traces in pooled.items()}
    return {"fused": fused, "reliability": curves}


def pool(banks: Sequence[tuple[str, Groups]]) -> Groups:
    """The drives of all banks."""
    return {
        timing: [trace for _, groups in banks for trace in groups[timing]] for timing in banks[0][1]
    }


def _fused(traces: Sequence[Trace]) -> dict[str, Any]:
    correct, estimate = held(*traces)
    sure = estimate >= SURE
    away = ~np.concatenate([trace.has_place for trace in traces])
    measured = audit(*traces, bins=BINS)
    assert measured is not None  # every drive gives p̂
    return {
        "drives": len(traces),
        "frames": int(correct.size),
        **measured._asdict(),
        "brier": metrics.brier(correct, estimate),
        "right_of_sure": float(correct[sure].mean()) if sure.any() else None,
        "sure_of_away": float(sure[away].mean()) if away.any() else None,
    }


def _curve(traces: Sequence[Trace]) -> dict[str, list[Any]]:
    return {
        name: [None if v != v else v for v in values.tolist()]  # v != v: nan
        for name, values in metrics.reliability(*held(*traces), BINS)._asdict().items()
    }


def table_of(report: Mapping[str, Any]) -> Table:
    """The report of :func:`held_against_truth` as a table."""
    heads = {
        "frames": "frames",
        "accuracy": "right",
        "p_correct": "mean p̂",
        "auroc": "AUROC",
        "calibration_error": f"calibration error, {BINS} bins",
        "brier": "Brier",
        "right_of_sure": f"right where p̂ ≥ {SURE}",
        "sure_of_away": f"p̂ ≥ {SURE} where no place is true",
    }
    rows = [
        [row["bank"], row["timing"], *(_cell(row[name]) for name in heads)]
        for row in report["fused"]
    ]
    chances = ", ".join(f"{rate:g}" for rate in RATES)
    return Table(
        "p̂ of the fused prediction under random activity",
        ["bank", "drive", *heads.values()],
        rows,
        f"On each frame each technique runs with a chance drawn for the drive: {chances}; at "
        "least the cheapest. A frame counts once in each drive; as recorded, all drives at "
        "chance 1 are the same.",
        words=2,
    )


def _cell(value: float | None) -> str:
    return "-" if value is None else str(value) if isinstance(value, int) else f"{value:.3f}"


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
    alone = [
        drive(f"single:{name}", bank, args.statistic) for bank in banks for name in bank.techniques
    ]
    report: dict[str, Any] = {"statistic": args.statistic, **assess(alone)}
    print(table(report))
    within = report["within"]
    if within["auroc"] is not None:
        print(
            f"\nwithin techniques: mean AUROC {within['auroc']:.4f}, least "
            f"{within['least_auroc']:.4f}, of {within['techniques']} that are sometimes wrong"
        )
    driven = [(bank.name, random_drives(bank, args.statistic, retimed)) for bank in banks]
    report["random"] = held_against_truth(driven)
    text = table_of(report["random"]).markdown()
    print(f"\n{text}")
    written = json.dumps(report, indent=1, allow_nan=False)
    write_whole(args.out / "correctness.json", written.encode() + b"\n")
    write_whole(args.out / "tables.md", text.encode() + b"\n")
    plots.reliability({"each technique alone": alone}, args.out / "reliability.png")
    title = f"Estimated correctness under random activity: {args.statistic}"
    path = args.out / "reliability_random.png"
    plots.reliability(pool(driven), path, title=title, bins=BINS)
    print(f"\n{args.out / 'correctness.json'}")


if __name__ == "__main__":
    run(main)
