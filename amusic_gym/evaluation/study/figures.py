"""The figures of a study: what the compute buys under every motion, over all routes and on each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

from amusic_gym.evaluation.plots import labels, tradeoff
from amusic_gym.evaluation.plots.drawing import GREY, Note, figure_at, place_notes
from amusic_gym.evaluation.report import ReportFigure
from amusic_gym.evaluation.study.cells import CONDITIONS
from amusic_gym.evaluation.study.findings import Findings
from amusic_gym.evaluation.study.plan import MEAN
from amusic_gym.evaluation.study.run import Row
from amusic_gym.policies.registry import (
    AMUSIC,
    CASCADE,
    FAMILIES,
    FIXED,
    LEARNED,
    MARK,
    MAY_IDLE,
    PEER,
    VARIANT,
    Spec,
    front_of,
    parse,
)
from amusic_gym.utils.storage import keep_only

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROUTES_PER_FIGURE = 4
LEAST_ROUTES = 5  # from so many routes on, bands are over seeds and routes; with fewer, over seeds
MOST_NAMES = 4  # fixed subsets named in a panel, of those that raise the front by so much:
LEAST_GAIN = 0.01
FRAMED = (FIXED, CASCADE, AMUSIC, LEARNED)
"""Families that a panel reaches down to; others further below are told in words."""

PEER_COLOUR = "#5D646D"
PEER_MARKS = ("P", "X", "p", "h", "<", ">", "d", "8")
LEARNED_COLOURS = (*labels.SWEEP_COLOURS, "#332288", "#44AA99", "#882255", "#8C6D31")
LEARNED_MARKS = ("o", "s", "D", "^", "v", "p")


class _Style(NamedTuple):
    """How a policy looks in all panels."""

    colour: str
    marker: str
    label: str


def draw(findings: Findings, folder: str | Path) -> list[ReportFigure]:
    """Write the figures as PNG files to ``folder``; those of an earlier study go.

    ``fronts.png``: the mean over routes, or the only route; ``routes.png``: every route, if there
    are several, `ROUTES_PER_FIGURE` to a file. Policies under another statistic are left out.
    """
    folder = Path(folder)
    drawable = {row["bank"] for row in findings.points if _is_shown(row)}
    routes = [route["bank"] for route in findings.routes if route["bank"] in drawable]
    starts = range(0, len(routes), ROUTES_PER_FIGURE)
    pages = [routes[i : i + ROUTES_PER_FIGURE] for i in starts] if len(routes) > 1 else []
    names = ["routes"] if len(pages) == 1 else [f"routes-{i + 1}" for i in range(len(pages))]
    whole = [MEAN] if MEAN in drawable else routes if len(routes) == 1 else []
    figures = []
    for name, scopes in [("fronts", whole), *zip(names, pages, strict=True)]:
        if scopes:
            path = folder / f"{name}.png"
            _draw(findings, scopes, path)
            where = ", ".join(_where(findings, scope) for scope in scopes)
            caption = f"AUC against compute: {where}; {_bands(findings, scopes)}."
            figures.append(ReportFigure(path, caption))
    keep_only(folder, "study's figures", [figure.path for figure in figures])
    return figures


def _draw(findings: Findings, scopes: Sequence[str], path: Path) -> None:
    """A row of panels for each scope, a column for each condition."""
    conditions = findings.settings["conditions"]
    rows = tradeoff.placed([r for r in findings.points if r["bank"] in scopes and _is_shown(r)])
    rows = _without_worse_peers(rows)
    styles = _styles(findings)
    height = 4.3 if len(scopes) == 1 else 3.4
    width = max(7.6, 5.6 * len(conditions))  # inches
    with figure_at(path, width, height * len(scopes) + 0.9) as figure:
        panels = figure.subplots(len(scopes), len(conditions), squeeze=False, sharex=True)
        known: dict[str, Any] = {}
        notes = []
        for line, scope in zip(panels, scopes, strict=True):
            for axes, condition in zip(line, conditions, strict=True):
                shown = [r for r in rows if (r["bank"], r["condition"]) == (scope, condition)]
                notes.append((axes, _draw_panel(axes, shown, styles), shown))
                axes.set_title(f"{_where(findings, scope)}, {CONDITIONS[condition]}")
                known |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        for axes in panels.flat:
            tradeoff.compute_axis(axes, [row["compute"] for row in rows])
        for line in panels:
            line[0].set_ylabel("AUC (precision-recall)")
        for axes in panels[-1]:
            costs = findings.settings["costs"]
            axes.set_xlabel(f"Compute, as a share of running everything ({costs} costs)")
        columns = max(3, 2 * len(conditions))
        truth = f"; {MARK} has seen ground truth" if findings.settings["needs_truth"] else ""
        figure.legend(
            known.values(),
            known.keys(),
            title=fill(_bands(findings, scopes).capitalize() + truth, int(13 * width)),
            loc="outside lower center",
            ncols=columns,
        )
        for axes, named, shown in notes if len(scopes) == 1 else []:  # several are too small
            place_notes(figure, axes, named, [(row["compute"], row["auc"]) for row in shown])


def _without_worse_peers(rows: Sequence[Row]) -> list[Row]:
    """The rows without those settings of a peer that another beats for no more compute."""
    of: dict[tuple[str | None, ...], list[Row]] = {}
    for row in rows:
        if row["family"] == PEER:
            front = front_of(row["policy"], PEER)
            of.setdefault((row["bank"], row["condition"], front), []).append(row)
    best = [row for group in of.values() for row in tradeoff.pareto(group)]
    return [row for row in rows if row["family"] != PEER or row in best]


def _bands(findings: Findings, scopes: Sequence[str]) -> str:
    many = MEAN in scopes and len(findings.routes) >= LEAST_ROUTES
    over = "seeds and routes" if many else "seeds"
    return f"bands and upright lines: 95 % bootstrap intervals over {over}"


def _is_shown(row: Row) -> bool:
    return row["family"] != VARIANT and parse(row["policy"]).policy.charted


def _where(findings: Findings, scope: str) -> str:
    return f"Mean over {len(findings.routes)} routes" if scope == MEAN else labels.bank_label(scope)


def _styles(findings: Findings) -> dict[str, _Style]:
    of = {row["policy"]: row["family"] for row in findings.points if _is_shown(row)}
    learned = [name for name, family in of.items() if family == LEARNED]
    peers = [*dict.fromkeys(parse(n).policy for n, family in of.items() if family == PEER)]
    styles = {}
    for name, family in of.items():
        known = parse(name)
        colour, marker = known.policy.colour or GREY, known.policy.marker
        if family == LEARNED:
            at = learned.index(name)
            colour = LEARNED_COLOURS[at % len(LEARNED_COLOURS)]
            marker = LEARNED_MARKS[at % len(LEARNED_MARKS)]
        elif family == PEER:
            colour, marker = PEER_COLOUR, PEER_MARKS[peers.index(known.policy) % len(PEER_MARKS)]
        label = Spec(known.policy, None).label if family == PEER else known.label
        if MARK not in label and name in findings.settings["needs_truth"]:
            label += f" {MARK}"
        styles[name] = _Style(colour, marker, labels.legend_name(label))
    return styles


def _draw_panel(axes: Axes, rows: Sequence[Row], styles: dict[str, _Style]) -> list[Note]:
    notes = tradeoff.draw_subsets(axes, rows, MOST_NAMES, LEAST_GAIN)
    grouped = _grouped(rows)
    for family in dict.fromkeys(grouped.values()):
        best = tradeoff.pareto([row for row in rows if grouped.get(row["policy"]) == family])
        _, words, colour, marker = FAMILIES[family]
        line = "--" if family == MAY_IDLE else "-"
        tradeoff.draw_front(axes, best, colour, marker, f"best {words}", line)
    rest = [r for r in rows if r["family"] != FIXED and r["policy"] not in grouped]
    for name in dict.fromkeys(row["policy"] for row in rest if _is_swept(row)):
        colour, marker, label = styles[name]
        style = marker + ("--" if parse(name).is_variant else "-")
        own = [row for row in rest if row["policy"] == name]
        sweep = tradeoff.draw_sweep(axes, own, colour, style, label)
        if all(bands := [_band(row) for row in sweep]):
            low, high = zip(*filter(None, bands), strict=True)
            xs = [row["compute"] for row in sweep]
            axes.fill_between(xs, low, high, color=colour, alpha=0.15, linewidth=0, zorder=2)
    others = [row for row in rest if not _is_swept(row)]
    for row in [*others, *(row for row in rows if row["policy"] == "music")]:
        colour, marker, label = styles[row["policy"]]
        tradeoff.draw_mark(axes, row, colour, marker, label)
        if ends := _band(row):
            axes.vlines(
                row["compute"], ends[0], ends[1], color=colour, linewidth=1.0, alpha=0.6, zorder=3
            )
    _frame(axes, rows, styles)
    return notes


def _grouped(rows: Sequence[Row]) -> dict[str, str]:
    """Policies of families so large that they are drawn as one front, and their families."""
    of = {row["policy"]: row["family"] for row in rows if FAMILIES[row["family"]].best}
    return {name: family for name, family in of.items() if list(of.values()).count(family) > 2}


def _frame(axes: Axes, rows: Sequence[Row], styles: dict[str, _Style]) -> None:
    """Let the axis end below the policies that matter; say in words who is further below."""
    framed = [row["auc"] for row in rows if row["family"] in FRAMED] or [r["auc"] for r in rows]
    low, high = min(framed, default=0.0), max([row["auc"] for row in rows], default=1.0)
    margin = max(0.08 * (high - low), 0.005)
    lines = _grouped(rows)  # and those over λ show where they go
    points = [row for row in rows if not _is_swept(row) and row["policy"] not in lines]
    below = sorted((r for r in points if r["auc"] < low - margin), key=lambda row: -row["auc"])
    axes.set_ylim(low - margin * (3 if below else 1), high + margin)
    if below:
        words = ", ".join(f"{styles[row['policy']].label} {row['auc']:.2f}" for row in below)
        text = fill(f"further below: {words}", 60)
        axes.text(0.99, 0.02, text, transform=axes.transAxes, ha="right", color=GREY, fontsize=8)


def _is_swept(row: Row) -> bool:
    return row["family"] == LEARNED or row["compute_weight"] is not None


def _band(row: Row) -> Sequence[float] | None:
    """The interval to draw: over seeds and routes only where there are enough routes."""
    ends: Sequence[float] | None = row["auc_interval_seeds"]
    if row["bank"] == MEAN and row["routes"] >= LEAST_ROUTES:
        ends = row["auc_interval"]
    return ends
