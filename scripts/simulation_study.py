"""Compare simulated routes with real recordings: a table, and figures into --out.

The recordings are the banks given by --bank; with the variable AMUSIC_DATA, Corridor too. With
--speeds, a table of the AUC on simulated routes driven at other speeds instead.
"""

import io
import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from textwrap import fill

import numpy as np
from _cli import Parser, destination, run
from _drives import drive
from amusic_baselines.scores import standardised
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.importers import from_recording
from amusic_gym.estimation.settings import STATISTICS
from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.plots.drawing import GREY, INK, figure_at
from amusic_gym.routes.motion import MOTIONS
from amusic_gym.routes.retime import NOISE, retimed_truth
from amusic_gym.routes.simulate import POPULATION, Simulation
from amusic_gym.routes.statistics import MEASURES, describe
from amusic_gym.utils.escaping import CsvWriter
from amusic_gym.utils.storage import write_whole

ROUTES, SEED = 60, 1000
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
SHOWN = 4  # matrices of each kind in the figure
SIMULATED, REAL = "#4C72B0", "#C44E52"

SPEEDS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, -1.0)  # places per frame
FRAMES = 100  # of a drive at a speed, along a route of four times as many

Rows = dict[str, dict[str, float]]  # "bank technique" -> its measures


def recordings(paths: Sequence[Path]) -> list[ScoreBank]:
    """The given banks, and Corridor where there is one."""
    banks = [ScoreBank.load(path) for path in paths]
    if named := os.environ.get("AMUSIC_DATA"):
        banks.append(from_recording(Path(named) / "corridor"))
    if not banks:
        raise ValueError("no recording to compare with; give --bank or set AMUSIC_DATA")
    return banks


def alone(bank: ScoreBank, statistic: str) -> list[NDArray[np.int64]]:
    """Predictions (Q,) of each technique when it alone runs, on all frames."""
    return [drive(f"single:{name}", bank, statistic).predictions for name in bank.techniques]


def measure(banks: Sequence[ScoreBank]) -> Rows:
    """The measures of each technique of each bank."""
    rows: Rows = {}
    for bank in banks:
        places = {statistic: alone(bank, statistic) for statistic in STATISTICS}
        for t, technique in enumerate(bank.techniques):
            given = {statistic: places[statistic][t] for statistic in STATISTICS}
            rows[f"{bank.name} {technique}"] = describe(bank, t, given)
    return rows


def column(rows: Rows, key: str) -> NDArray[np.float64]:
    """One measure over all rows that have it."""
    values = np.array([row[key] for row in rows.values()])
    return np.asarray(values[np.isfinite(values)])


def driven(bank: ScoreBank, speed: float, rng: np.random.Generator) -> ScoreBank:
    """`FRAMES` frames along a recording, at so many of its frames per frame, from any of them."""
    steps = speed * np.arange(FRAMES)
    frames = np.floor(rng.integers(bank.queries - abs(steps[-1])) + steps - min(steps[-1], 0.0))
    taken = frames.astype(np.int64)
    scores = bank.scores[:, taken]
    noise = NOISE * scores.std(axis=2, keepdims=True) * rng.standard_normal(scores.shape)
    return ScoreBank(
        scores + noise,
        bank.techniques,
        bank.seconds,
        tolerance=bank.tolerance,
        ground_truth=retimed_truth(bank.truth, taken),
    )


def print_speeds(seeds: Sequence[int]) -> None:
    """Markdown: mean AUC at every speed, by all techniques and by random ones."""
    routes = replace(POPULATION, retimed=0.0, queries=(4 * FRAMES, 4 * FRAMES))
    ways = list(product(("belief", "evidence"), ("music", "random:0.3")))
    areas = np.empty((len(ways), len(SPEEDS), len(seeds)))
    for i, seed in enumerate(seeds):
        bank = routes.route(np.random.default_rng(seed))
        for (w, (statistic, name)), (v, speed) in product(enumerate(ways), enumerate(SPEEDS)):
            route = driven(bank, speed, np.random.default_rng(seed))
            areas[w, v, i] = metrics.area(*metrics.curve(drive(name, route, statistic, seed)))
    print(f"| places per frame | {' | '.join(f'{speed:g}' for speed in SPEEDS)} |")
    print("|---" * (len(SPEEDS) + 1) + "|")
    for way, means in zip(ways, areas.mean(axis=2), strict=True):
        print(f"| {', '.join(way)} | {' | '.join(f'{mean:.3f}' for mean in means)} |")


def print_table(simulated: Rows, real: Rows) -> None:
    """Markdown: quantiles of the simulated techniques beside the range of the real ones."""
    quantiles = " | ".join(f"{100 * q:.0f} %" for q in QUANTILES)
    print(f"simulated: {len(simulated)} techniques; real: {len(real)}: {', '.join(real)}\n")
    print(f"| measure | sim. {quantiles} | real min | median | max | inside |")
    print("|---" * (len(QUANTILES) + 5) + "|")
    for key, meaning in MEASURES.items():
        ours, theirs = column(simulated, key), column(real, key)
        cells = [*np.quantile(ours, QUANTILES), theirs.min(), np.median(theirs), theirs.max()]
        low, high = cells[0], cells[len(QUANTILES) - 1]
        inside = int(((theirs >= low) & (theirs <= high)).sum())
        numbers = " | ".join(f"{cell:.2f}" for cell in cells)
        print(f"| {meaning} | {numbers} | {inside} of {theirs.size} |")


def write_table(simulated: Rows, real: Rows, path: Path) -> None:
    """All measures of all techniques, as CSV."""
    table = io.StringIO()
    writer = CsvWriter(table)
    writer.writerow(["kind", "matrix", *MEASURES])
    for kind, rows in (("simulated", simulated), ("real", real)):
        for name, row in rows.items():
            writer.writerow([kind, name, *(f"{row[key]:.6g}" for key in MEASURES)])
    write_whole(path, table.getvalue().encode())


def draw_measures(simulated: Rows, real: Rows, path: Path) -> None:
    """One panel per measure: histogram of the simulated techniques, a line per real one."""
    across = 3
    down = -(-len(MEASURES) // across)
    with figure_at(path, 10.0, 1.85 * down) as figure:
        for panel, (key, meaning) in enumerate(MEASURES.items()):
            axes = figure.add_subplot(down, across, panel + 1)
            ours, theirs = column(simulated, key), column(real, key)
            axes.hist(ours, bins=24, color=SIMULATED, alpha=0.75, label="simulated techniques")
            for i, value in enumerate(theirs):
                axes.axvline(value, color=REAL, lw=1.0, label="" if i else "real techniques")
            axes.set_title(fill(meaning, 46), fontsize=7.5, color=INK)
            axes.tick_params(labelsize=7, colors=GREY)
            if panel == 0:
                axes.legend(fontsize=7)


def draw_matrices(simulated: Sequence[ScoreBank], real: Sequence[ScoreBank], path: Path) -> None:
    """Score matrices of either kind, rows standardised, the same grey scale everywhere."""
    kinds = (("simulated", simulated), ("real", real))
    with figure_at(path, 10.0, 5.6) as figure:
        for line, (kind, banks) in enumerate(kinds):
            matrices = [
                (f"{bank.name} {name}", bank.scores[t])
                for bank in banks
                for t, name in enumerate(bank.techniques)
            ]
            step = max(1, len(matrices) // SHOWN)
            for i, (name, scores) in enumerate(matrices[::step][:SHOWN]):
                axes = figure.add_subplot(2, SHOWN, line * SHOWN + i + 1)
                axes.imshow(standardised(scores), cmap="gray", vmin=-2.5, vmax=3.0, aspect="auto")
                axes.set_title(f"{kind}: {name}", fontsize=8)
                axes.set_xlabel("place", fontsize=7)
                axes.set_ylabel("frame", fontsize=7)
                axes.tick_params(labelsize=6)


def main() -> None:
    """Draw routes, measure both kinds, print and write."""
    parser = Parser(description=__doc__)
    add = parser.add_argument
    add("--out", type=destination, default=Path("out/simulation"), metavar="DIR", help="of figures")
    add("--bank", type=Path, action="append", default=[], metavar="BANK")
    add("--routes", type=int, default=ROUTES, metavar="N", help="simulated routes")
    add("--seed", type=int, default=SEED, metavar="S", help="of the first route")
    add("--motion", choices=MOTIONS, default=Simulation.motion)
    add("--speeds", action="store_true", help="AUC at several speeds instead")
    args = parser.parse_args()
    if args.routes < 1 or args.seed < 0:
        raise ValueError(
            f"--routes is {args.routes} and --seed {args.seed}; give at least 1 and at least 0"
        )
    seeds = range(args.seed, args.seed + args.routes)
    if args.speeds:
        print_speeds(seeds)
        return
    real = recordings(args.bank)
    simulation = Simulation(motion=args.motion)
    drawn = [simulation.route(np.random.default_rng(s), name=f"seed {s}") for s in seeds]
    ours, theirs = measure(drawn), measure(real)
    print_table(ours, theirs)
    write_table(ours, theirs, args.out / "measures.csv")
    draw_measures(ours, theirs, args.out / "measures.png")
    draw_matrices(drawn, real, args.out / "matrices.png")
    print(f"\n{args.out}: measures.csv, measures.png, matrices.png")


if __name__ == "__main__":
    run(main)
