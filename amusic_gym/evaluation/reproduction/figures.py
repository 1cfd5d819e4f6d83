"""The paper's figures 3 to 7, and one of the sweep of E and M, each as PNG and PDF."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym.evaluation import plots
from amusic_gym.evaluation.plots.drawing import figure_at
from amusic_gym.evaluation.report import ReportFigure
from amusic_gym.evaluation.reproduction.paper import METHODS, TECHNIQUES, TITLES
from amusic_gym.evaluation.reproduction.sweeps import BLOCKS, CANDIDATES, COVERAGES, HISTORIES
from amusic_gym.evaluation.reproduction.tables import Cells
from amusic_gym.policies.trace import Trace
from amusic_gym.routes.datasets import LoadedRoute
from amusic_gym.utils.colours import PAPER_COLOURS, sequence, tint

Rows = Sequence[Mapping[str, Any]]


def both(draw: Callable[[Any, Path], object], of: Any, path: Path, caption: str) -> ReportFigure:
    """Draw a figure of something as PNG and as PDF."""
    draw(of, path.with_suffix(".pdf"))
    draw(of, path)
    return ReportFigure(path, caption)


def ablation(rows: Rows, path: Path) -> None:
    """Figure 3: accuracy and milliseconds per correction over K, a curve per F."""
    with figure_at(path, 8.6, 3.8) as figure:
        for axes, key, name in zip(
            figure.subplots(1, 2),
            ("accuracy", "milliseconds"),
            ("Mean accuracy", "Milliseconds per correction"),
            strict=True,
        ):
            for history, colour in zip(HISTORIES, sequence(len(HISTORIES)), strict=True):
                values = [row[key] for row in rows if row["history"] == history]
                axes.plot(CANDIDATES, values, marker="o", color=colour, label=f"F = {history}")
            axes.set(xscale="log", xlabel="K, candidates", ylabel=name)
            axes.set_xticks(CANDIDATES, [str(k) for k in CANDIDATES])
            axes.minorticks_off()
            axes.grid()
        axes.set_ylim(bottom=0.0)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)


def accuracies(cells: Cells, path: Path) -> None:
    """Figure 4: accuracy of each technique alone and with SIC, per data set."""
    names = [name for name in TITLES if name in cells]
    width = 0.8 / (2 * len(TECHNIQUES))
    with figure_at(path, 1.8 + 1.9 * len(names), 3.6) as figure:
        axes = figure.add_subplot()
        for i, technique in enumerate(TECHNIQUES):
            for j, (method, strength) in enumerate(((technique, 0.4), (f"{technique}+SIC", 1.0))):
                aside = (2 * i + j - len(TECHNIQUES) + 0.5) * width
                values = [cells[name][method]["accuracy"] for name in names]
                colour = tint(PAPER_COLOURS[technique], strength)
                axes.bar(np.arange(len(names)) + aside, values, width, color=colour, label=method)
        axes.set_xticks(range(len(names)), [TITLES[name] for name in names])
        axes.set(ylim=(0, 1), ylabel="Accuracy")
        axes.grid(axis="y")
        figure.legend(loc="outside upper center", ncols=4)


def sweep(rows: Rows, path: Path) -> None:
    """AUC (the paper's measure) and PTR of A-MuSIC over E, a curve per M."""
    with figure_at(path, 8.6, 3.8) as figure:
        for axes, key, name in zip(
            figure.subplots(1, 2), ("auc_paper", "ptr"), ("AUC", "PTR"), strict=True
        ):
            for block, colour in zip(BLOCKS, sequence(len(BLOCKS)), strict=True):
                own = {row["policy"]: row[key] for row in rows}
                values = [own[f"amusic:mean/{block}/{coverage}"] for coverage in COVERAGES]
                axes.plot(COVERAGES, values, marker="o", color=colour, label=f"M = {block}")
            axes.set(xlabel="E, coverage of a selection", ylabel=name)
            axes.grid()
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)


def drives(traces: Sequence[Trace], out: Path) -> Iterator[ReportFigure]:
    """Figures 5, 6 and 7: curves, MuSIC's shares, and selections along each route."""
    by_bank = {name: [t for t in traces if t.bank == name] for name in TITLES}
    by_bank = {name: own for name, own in by_bank.items() if own}
    for name, own in by_bank.items():
        # recall relative to the correct matches, as in `auc_paper`
        scored = [replace(t, confidence=t.similarity, has_place=t.correct) for t in own]
        yield both(
            plots.precision_recall,
            scored,
            out / f"figure5-{name}.png",
            f"Figure 5, {TITLES[name]}: precision and recall over the similarity of the match.",
        )
    music = [t for own in by_bank.values() for t in own if t.policy == METHODS["MuSIC"]]
    yield both(
        plots.shares,
        music,
        out / "figure6.png",
        "Figure 6: which technique MuSIC takes its match from.",
    )
    for name, own in by_bank.items():
        adaptive = [trace for trace in own if trace.policy == METHODS["A-MuSIC"]]
        yield both(
            plots.selections,
            adaptive,
            out / f"figure7-{name}.png",
            f"Figure 7, {TITLES[name]}: what A-MuSIC runs; lines are selections.",
        )


def one_drive(
    traces: Sequence[Trace], parts: Sequence[LoadedRoute], out: Path
) -> Iterator[ReportFigure]:
    """Figure 7 of the data sets in one drive."""
    firsts = accumulate((len(part.query) for part in parts), initial=0)
    named = [(first, TITLES[part.name]) for first, part in zip(firsts, parts, strict=False)]
    yield both(
        partial(plots.selections, parts=named),
        [trace for trace in traces if trace.policy == METHODS["A-MuSIC"]],
        out / f"figure7-{traces[0].bank}.png",
        f"Figure 7, {', '.join(name for _, name in named)} in one drive: what A-MuSIC runs.",
    )
