"""AUC against compute: what every policy buys, and for how much."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from amusic_gym.evaluation.plots import labels
from amusic_gym.evaluation.plots.drawing import GREY, Note, figure_at, only, percent, place_notes
from amusic_gym.utils import colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 7.6  # inches, also of a legend's line and, on average, of a letter beside it:
HANDLE, LETTER = 0.6, 0.065
MOST_LABELS = 8  # fixed subsets named in the figure
Point = tuple[float, float, Mapping[str, Any]]  # compute, auc, the row


def front(rows: Sequence[Mapping[str, Any]], path: str | Path) -> Path:
    """AUC against compute of one bank's (or the mean) rows: who buys the most with the least.

    Grey: every fixed subset, their Pareto front as a step line, its members named. Connected: a
    policy at several compute weights. Rows without SIC (`raw:`) are left out. A policy that costs
    nothing stands at half the least cost, the axis being logarithmic.
    """
    bank = only({row["bank"] for row in rows}, "bank", "rows")
    costs = only({row["costs"] for row in rows}, "cost model", "rows")
    shown = [row for row in rows if not row["policy"].startswith("raw:")]
    paid = [row["compute"] for row in shown if row["compute"] > 0]
    floor = min(paid, default=1.0) / 2.0
    points = [(max(row["compute"], floor), row["auc"], row) for row in shown]
    with figure_at(path, WIDTH, 5.2) as figure:
        axes = figure.add_subplot()
        axes.set_xscale("log")
        notes = _draw_fixed(axes, points)
        notes += _draw_sweeps(axes, [p for p in points if p[2]["compute_weight"] is not None])
        notes += _draw_policies(axes, points)
        _percent_axis(axes, [x for x, _, _ in points])
        axes.set(xlabel=f"Compute: share of running every technique on every frame ({costs} costs)")
        axes.set_ylabel("AUC (precision-recall)")
        where = "mean over banks" if bank == "mean" else labels.bank_label(bank)
        axes.set_title(f"What the compute buys: {where}")
        axes.grid()
        axes.margins(y=0.1)  # room for labels above the best and below the worst
        if names := axes.get_legend_handles_labels()[1]:
            figure.legend(loc="outside lower center", ncols=_columns(names))
        place_notes(figure, axes, notes, [(x, y) for x, y, _ in points])
    return Path(path)


def pareto(points: Sequence[Point]) -> list[Point]:
    """The points that no cheaper or equally cheap one reaches, by rising compute."""
    kept: list[Point] = []
    for point in sorted(points, key=lambda p: (p[0], -p[1])):
        if not kept or point[1] > kept[-1][1]:
            kept.append(point)
    return kept


def _columns(names: Sequence[str]) -> int:
    """How many columns of a legend fit below the figure, 3 at most."""
    widest = HANDLE + LETTER * max(map(len, names))
    return min(3, max(1, int(WIDTH / widest)))


def _is_fixed(row: Mapping[str, Any]) -> bool:
    return row["policy"].partition(":")[0] in labels.FIXED


def _draw_fixed(axes: Axes, points: Sequence[Point]) -> list[Note]:
    subsets = [p for p in points if _is_fixed(p[2])]
    if not subsets:
        return []
    axes.plot(
        [x for x, _, _ in subsets],
        [y for _, y, _ in subsets],
        "o",
        color=colours.NEUTRAL_COLOUR,
        markersize=5 if len(subsets) < 100 else 3,
        label="fixed subset",
    )
    # MuSIC, the set of all techniques, ends the front; it has a mark and a label of its own.
    best = pareto([p for p in points if p in subsets or p[2]["policy"] == "music"])
    xs = [x for x, _, _ in best] + [max(1.0, best[-1][0])]
    ys = [y for _, y, _ in best] + [best[-1][1]]
    axes.step(xs, ys, where="post", color=GREY, linewidth=1.2, label="best fixed subset")
    axes.plot(xs[:-1], ys[:-1], "o", color=GREY, markersize=5)
    best = [p for p in best if _is_fixed(p[2])]
    gains = np.diff([0.0, *(y for _, y, _ in best)])
    named = sorted(np.argsort(-gains, kind="stable")[:MOST_LABELS])
    return [(best[i][0], best[i][1], _row_label(best[i][2]), "#666666") for i in named]


def _draw_sweeps(axes: Axes, points: Sequence[Point]) -> list[Note]:
    notes: list[Note] = []
    for number, policy in enumerate(dict.fromkeys(row["policy"] for _, _, row in points)):
        sweep = sorted(
            (p for p in points if p[2]["policy"] == policy), key=lambda p: p[2]["compute_weight"]
        )
        colour = labels.sweep_colour(number)
        axes.plot(
            [x for x, _, _ in sweep],
            [y for _, y, _ in sweep],
            "o-",
            color=colour,
            linewidth=2,
            markersize=6,
            zorder=4,
            label=labels.legend_name(f"{_row_label(sweep[0][2])}, by compute weight λ"),
        )
        notes += [(x, y, labels.weight_label(r["compute_weight"]), colour) for x, y, r in sweep]
    return notes


def _draw_policies(axes: Axes, points: Sequence[Point]) -> list[Note]:
    notes: list[Note] = []
    for x, y, row in points:
        if _is_fixed(row) or row["compute_weight"] is not None:
            continue
        colour, marker = labels.policy_mark(row["policy"])
        hollow = labels.is_variant(row["policy"])
        axes.plot(
            x,
            y,
            marker,
            markersize=12 if marker == "*" else 8,
            color="white" if hollow else colour,
            markeredgecolor=colour if hollow else "white",
            markeredgewidth=1.8 if hollow else 0.8,
            zorder=5,
        )
        notes.append((x, y, _row_label(row), colour))
    return notes


def _row_label(row: Mapping[str, Any]) -> str:
    return labels.policy_label(row["policy"])


def _percent_axis(axes: Axes, values: Sequence[float]) -> None:
    """Ticks at 1, 2, 5, 10 ... % of compute; a decade around a single value."""
    low, high = min(values, default=0.1), max([1.0, *values])
    axes.set_xlim(low / 1.35, high * 1.35)
    ticks = [m * 10.0**e for e in range(-8, 2) for m in (1, 2, 5)]
    axes.set_xticks([t for t in ticks if low / 1.35 <= t <= high * 1.35], minor=False)
    axes.minorticks_off()
    axes.xaxis.set_major_formatter(percent)
