"""AUC against compute: what every policy buys, and for how much."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from amusic_gym.evaluation.plots import labels
from amusic_gym.evaluation.plots.drawing import GREY, Note, figure_at, only, percent, place_notes
from amusic_gym.policies.registry import FIXED, parse
from amusic_gym.utils import colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 7.6  # inches, also of a legend's line and, on average, of a letter beside it:
HANDLE, LETTER = 0.6, 0.065
MOST_LABELS = 8  # fixed subsets named in the figure
MOST_WEIGHTS_NAMED = 16  # λ in the figure; of more every other one is named
Row = dict[str, Any]  # of results: policy, compute_weight, compute, auc and so on


def front(rows: Sequence[Row], path: str | Path) -> Path:
    """AUC against compute of one bank's (or the mean) rows: who buys the most with the least.

    Grey: every fixed subset, their Pareto front as a step line, its members named. Connected: a
    policy at several compute weights. Rows without SIC (`raw:`) are left out. A policy that costs
    nothing stands at half the least cost, the axis being logarithmic.
    """
    bank = only({row["bank"] for row in rows}, "bank", "rows")
    costs = only({row["costs"] for row in rows}, "cost model", "rows")
    shown = placed(rows)
    swept = [row for row in shown if row["compute_weight"] is not None]
    with figure_at(path, WIDTH, 5.2) as figure:
        axes = figure.add_subplot()
        notes = draw_subsets(axes, shown, MOST_LABELS)
        for number, policy in enumerate(dict.fromkeys(row["policy"] for row in swept)):
            sweep = [row for row in swept if row["policy"] == policy]
            colour = labels.sweep_colour(number)
            name = f"{labels.policy_label(policy)}, by compute weight λ"
            draw_sweep(axes, sweep, colour, "o-", labels.legend_name(name))
            notes += [
                _note(row, labels.weight_label(row["compute_weight"]), colour)
                for row in sweep[:: 1 if len(swept) <= MOST_WEIGHTS_NAMED else 2]
            ]
        for row in shown:
            known = parse(row["policy"])
            if known.policy.colour and row["compute_weight"] is None:
                draw_mark(axes, row, known.policy.colour, known.policy.marker)
                notes.append(_note(row, known.label, known.policy.colour))
        compute_axis(axes, [row["compute"] for row in shown])
        axes.set(xlabel=f"Compute: share of running every technique on every frame ({costs} costs)")
        axes.set_ylabel("AUC (precision-recall)")
        where = "mean over banks" if bank == "mean" else labels.bank_label(bank)
        axes.set_title(f"What the compute buys: {where}")
        axes.margins(y=0.1)  # room for labels above the best and below the worst
        if names := axes.get_legend_handles_labels()[1]:
            figure.legend(loc="outside lower center", ncols=_columns(names))
        place_notes(figure, axes, notes, [(row["compute"], row["auc"]) for row in shown])
    return Path(path)


def placed(rows: Sequence[Row]) -> list[Row]:
    """The rows to chart; what costs nothing at half the least cost, for a logarithmic axis."""
    shown = [row for row in rows if parse(row["policy"]).policy.charted]
    floor = min([row["compute"] for row in shown if row["compute"] > 0], default=1.0) / 2.0
    return [{**row, "compute": max(row["compute"], floor)} for row in shown]


def pareto(rows: Sequence[Row]) -> list[Row]:
    """The rows that no cheaper or equally cheap one reaches, by rising compute."""
    kept: list[Row] = []
    for row in sorted(rows, key=lambda row: (row["compute"], -row["auc"])):
        if not kept or row["auc"] > kept[-1]["auc"]:
            kept.append(row)
    return kept


def draw_front(
    axes: Axes, best: Sequence[Row], colour: str, marker: str, label: str, line: str = "-"
) -> None:
    """A Pareto front as a step line, to a compute of 1 at least, and its points."""
    xs, ys = [row["compute"] for row in best], [row["auc"] for row in best]
    axes.step(
        [*xs, max(1.0, xs[-1])],
        [*ys, ys[-1]],
        where="post",
        marker=marker,
        markevery=slice(len(best)),
        markersize=4.5,
        color=colour,
        linewidth=1.2,
        linestyle=line,
        zorder=3 if label != "best fixed subset" else 2,
        label=label,
    )


def draw_subsets(axes: Axes, rows: Sequence[Row], most: int, least_gain: float = 0.0) -> list[Note]:
    """All fixed subsets and their front; the names of the ``most`` that raise it most.

    A named one raises the AUC of the front by ``least_gain``.
    """
    # The row of a study has its family.
    fixed = [r for r in rows if (r.get("family") or parse(r["policy"]).policy.family) == FIXED]
    if not fixed:
        return []
    axes.plot(
        [row["compute"] for row in fixed],
        [row["auc"] for row in fixed],
        "o",
        color=colours.NEUTRAL_COLOUR,
        markersize=4 if len(fixed) < 100 else 3,
        label="fixed subset",
    )
    best = pareto(fixed)
    draw_front(axes, best, GREY, "o", "best fixed subset")
    gains = np.diff([0.0, *(row["auc"] for row in best)])
    # MuSIC, all techniques, has a mark and a label of its own.
    named = [i for i, row in enumerate(best) if parse(row["policy"]).policy.colour is None]
    named = [i for i in sorted(named, key=lambda i: -gains[i])[:most] if gains[i] >= least_gain]
    return [
        _note(best[i], labels.policy_label(best[i]["policy"]), "#666666") for i in sorted(named)
    ]


def draw_sweep(axes: Axes, rows: Sequence[Row], colour: str, style: str, label: str) -> list[Row]:
    """A policy over its compute weights, connected by rising compute; its rows in that order."""
    sweep = sorted(rows, key=lambda row: row["compute"])
    axes.plot(
        [row["compute"] for row in sweep],
        [row["auc"] for row in sweep],
        style,
        color=colour,
        linewidth=1.8,
        markersize=5,
        zorder=4,
        label=label,
    )
    return sweep


def draw_mark(axes: Axes, row: Row, colour: str, marker: str, label: str = "") -> None:
    """One policy's mark, hollow if it is a variant of another."""
    hollow = parse(row["policy"]).is_variant
    axes.plot(
        row["compute"],
        row["auc"],
        marker,
        markersize=11 if marker == "*" else 7,
        color="white" if hollow else colour,
        markeredgecolor=colour if hollow else "white",
        markeredgewidth=1.6 if hollow else 0.7,
        zorder=5,
        label=label or None,
    )


def compute_axis(axes: Axes, values: Sequence[float]) -> None:
    """A logarithmic axis, ticks at 1, 2, 5, 10 ... % of compute."""
    low, high = min(values, default=0.1) / 1.35, max([1.0, *values]) * 1.35
    ticks = [m * 10.0**e for e in range(-8, 2) for m in (1, 2, 5)]
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.set_xticks([tick for tick in ticks if low <= tick <= high], minor=False)
    axes.minorticks_off()
    axes.xaxis.set_major_formatter(percent)
    axes.grid()


def _note(row: Row, words: str, colour: str) -> Note:
    return row["compute"], row["auc"], words, colour


def _columns(names: Sequence[str]) -> int:
    """How many columns of a legend fit below the figure, 3 at most."""
    widest = HANDLE + LETTER * max(map(len, names))
    return min(3, max(1, int(WIDTH / widest)))
