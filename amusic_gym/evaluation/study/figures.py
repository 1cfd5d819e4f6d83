"""The figures of a study: what the compute buys, as recorded and re-timed, and on every route."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

from amusic_gym.evaluation.marks import MARK
from amusic_gym.evaluation.plots import labels
from amusic_gym.evaluation.plots.drawing import GREY, Note, figure_at, percent, place_notes
from amusic_gym.evaluation.plots.tradeoff import pareto
from amusic_gym.evaluation.report import ReportFigure
from amusic_gym.evaluation.study import cells as kinds
from amusic_gym.evaluation.study.findings import Findings
from amusic_gym.evaluation.study.plan import MEAN
from amusic_gym.evaluation.study.run import Row
from amusic_gym.utils import colours
from amusic_gym.utils.storage import keep_only

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROUTES_PER_FIGURE = 4
LEAST_ROUTES = 5
"""From so many routes on, bands are over seeds and routes; with fewer, over seeds."""

MOST_NAMES = 4  # fixed subsets named in a panel, of those that raise the front by so much:
LEAST_GAIN = 0.01
FRAMED = (kinds.FIXED, kinds.CASCADE, kinds.AMUSIC, kinds.LEARNED)
"""Families that a panel reaches down to; others further below are told in words."""
GROUPS = {
    kinds.CASCADE: labels.POLICY_MARKS["cascade"],
    kinds.PERIODIC: labels.POLICY_MARKS["periodic"],
    kinds.RANDOM: ("#CC9900", "v"),
    kinds.VOI: labels.POLICY_MARKS["voi"],
    kinds.IDLE: ("#4477AA", "o"),
}
"""Families of rules: colour and mark of their front, where more than two policies are in one."""

SHOWN_AS = {
    **{kinds.CASCADE: "cascade", kinds.PERIODIC: "periodic rule", kinds.RANDOM: "random choice"},
    **{kinds.VOI: "value of information", kinds.IDLE: "rule that may idle"},
}
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
    rows = _placed([r for r in findings.points if r["bank"] in scopes and _is_shown(r)])
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
                axes.set_title(f"{_where(findings, scope)}, {kinds.NAMES[condition]}")
                known |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        _compute_axes(panels, [row["compute"] for row in rows])
        for line in panels:
            line[0].set_ylabel("AUC (precision-recall)")
        for axes in panels[-1]:
            costs = findings.settings["costs"]
            axes.set_xlabel(f"Compute, as a share of running everything ({costs} costs)")
        columns = max(3, 2 * len(conditions))
        truth = f"; {MARK} needs ground truth" if findings.settings["needs_truth"] else ""
        figure.legend(
            known.values(),
            known.keys(),
            title=fill(_bands(findings, scopes).capitalize() + truth, int(13 * width)),
            loc="outside lower center",
            ncols=columns,
        )
        for axes, named, shown in notes if len(scopes) == 1 else []:  # several are too small
            place_notes(figure, axes, named, [(row["compute"], row["auc"]) for row in shown])


def _bands(findings: Findings, scopes: Sequence[str]) -> str:
    many = MEAN in scopes and len(findings.routes) >= LEAST_ROUTES
    over = "seeds and routes" if many else "seeds"
    return f"bands and upright lines: 95 % bootstrap intervals over {over}"


def _is_shown(row: Row) -> bool:
    return row["family"] != kinds.VARIANT and not row["policy"].startswith("raw:")


def _placed(rows: Sequence[Row]) -> list[Row]:
    """The axis is logarithmic: what costs nothing stands at half the least cost."""
    floor = min([row["compute"] for row in rows if row["compute"] > 0], default=1.0) / 2.0
    return [{**row, "compute": max(row["compute"], floor)} for row in rows]


def _where(findings: Findings, scope: str) -> str:
    return f"Mean over {len(findings.routes)} routes" if scope == MEAN else labels.bank_label(scope)


def _styles(findings: Findings) -> dict[str, _Style]:
    of = {row["policy"]: row["family"] for row in findings.points if _is_shown(row)}
    learned = [name for name, family in of.items() if family == kinds.LEARNED]
    peers = [name for name, family in of.items() if family == kinds.PEER]
    styles = {}
    for name, family in of.items():
        colour, marker = labels.policy_mark(name)
        if family == kinds.LEARNED:
            at = learned.index(name)
            colour = LEARNED_COLOURS[at % len(LEARNED_COLOURS)]
            marker = LEARNED_MARKS[at % len(LEARNED_MARKS)]
        elif family == kinds.PEER:
            colour, marker = PEER_COLOUR, PEER_MARKS[peers.index(name) % len(PEER_MARKS)]
        label = labels.policy_label(name)
        if MARK not in label and name in findings.settings["needs_truth"]:
            label += f" {MARK}"
        styles[name] = _Style(colour, marker, labels.legend_name(label))
    return styles


def _draw_panel(axes: Axes, rows: Sequence[Row], styles: dict[str, _Style]) -> list[Note]:
    axes.set_xscale("log")
    axes.grid()
    notes = _draw_fixed(axes, [row for row in rows if row["family"] == kinds.FIXED])
    grouped = _grouped(rows)
    for family in dict.fromkeys(grouped.values()):
        _draw_family(axes, [row for row in rows if grouped.get(row["policy"]) == family], family)
    rest = [r for r in rows if r["family"] != kinds.FIXED and r["policy"] not in grouped]
    swept = dict.fromkeys(row["policy"] for row in rest if _is_swept(row))
    for name in swept:
        _draw_sweep(axes, [row for row in rest if row["policy"] == name], styles[name])
    others = [row for row in rest if row["policy"] not in swept]
    for row in [*others, *(row for row in rows if row["policy"] == "music")]:
        _draw_policy(axes, row, styles[row["policy"]])
    _frame(axes, rows, styles)
    return notes


def _grouped(rows: Sequence[Row]) -> dict[str, str]:
    """Policies of families so large that they are drawn as one front, and their families."""
    of = {row["policy"]: row["family"] for row in rows if row["family"] in GROUPS}
    return {name: family for name, family in of.items() if list(of.values()).count(family) > 2}


def _draw_family(axes: Axes, rows: Sequence[Row], family: str) -> None:
    """The front of a family of rules as a step line, and its points."""
    colour, marker = GROUPS[family]
    best = pareto([(row["compute"], row["auc"], row) for row in rows])
    xs, ys = [x for x, _, _ in best], [y for _, y, _ in best]
    dashes = "--" if family == kinds.IDLE else "-"
    axes.step(
        [*xs, max(1.0, xs[-1])],
        [*ys, ys[-1]],
        where="post",
        color=colour,
        linewidth=1.2,
        linestyle=dashes,
        zorder=3,
    )
    axes.plot(xs, ys, marker, color=colour, markersize=4.5, label=f"best {SHOWN_AS[family]}")


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


def _draw_fixed(axes: Axes, rows: Sequence[Row]) -> list[Note]:
    """All fixed subsets, their front as a step line; names of those that raise it most."""
    if not rows:
        return []
    points = [(row["compute"], row["auc"], row) for row in rows]
    axes.plot(
        [x for x, _, _ in points],
        [y for _, y, _ in points],
        "o",
        color=colours.NEUTRAL_COLOUR,
        markersize=4,
        label="fixed subset",
    )
    best = pareto(points)
    xs = [x for x, _, _ in best] + [max(1.0, best[-1][0])]
    ys = [y for _, y, _ in best] + [best[-1][1]]
    axes.step(xs, ys, where="post", color=GREY, linewidth=1.3, label="best fixed subset")
    axes.plot(xs[:-1], ys[:-1], "o", color=GREY, markersize=4.5)
    named = [point for point in best if point[2]["policy"] != "music"]
    gains = [y - before for (_, y, _), before in zip(named, [0.0, *ys], strict=False)]
    kept = sorted(range(len(named)), key=lambda i: -gains[i])[:MOST_NAMES]
    return [
        (named[i][0], named[i][1], labels.policy_label(named[i][2]["policy"]), "#666666")
        for i in sorted(kept)
        if gains[i] >= LEAST_GAIN
    ]


def _is_swept(row: Row) -> bool:
    return row["family"] == kinds.LEARNED or row["compute_weight"] is not None


def _draw_sweep(axes: Axes, rows: Sequence[Row], style: _Style) -> None:
    """A learned selector or a rule over its λ, with the band of its interval."""
    sweep = sorted(rows, key=lambda row: row["compute"])
    xs, ys = [row["compute"] for row in sweep], [row["auc"] for row in sweep]
    dashes = "--" if labels.is_variant(rows[0]["policy"]) else "-"
    line: dict[str, Any] = {"color": style.colour, "linewidth": 1.8, "linestyle": dashes}
    line["zorder"] = 4
    axes.plot(xs, ys, style.marker, markersize=5, label=style.label, **line)
    ends = [_band(row) for row in sweep]
    if all(end is not None for end in ends):
        low, high = zip(*ends, strict=True)
        axes.fill_between(xs, low, high, color=style.colour, alpha=0.15, linewidth=0, zorder=2)


def _band(row: Row) -> Sequence[float] | None:
    """The interval to draw: over seeds and routes only where there are enough routes."""
    ends: Sequence[float] | None = row["auc_interval_seeds"]
    if row["bank"] == MEAN and row["routes"] >= LEAST_ROUTES:
        ends = row["auc_interval"]
    return ends


def _draw_policy(axes: Axes, row: Row, style: _Style) -> None:
    """One mark, with an upright line for its interval."""
    colour, hollow = style.colour, labels.is_variant(row["policy"])
    axes.plot(
        row["compute"],
        row["auc"],
        style.marker,
        markersize=11 if style.marker == "*" else 7,
        linestyle="",
        color="white" if hollow else colour,
        markeredgecolor=colour if hollow else "white",
        markeredgewidth=1.6 if hollow else 0.7,
        zorder=5,
        label=style.label,
    )
    if (ends := _band(row)) is not None:
        low, high = ends
        axes.vlines(row["compute"], low, high, color=colour, linewidth=1.0, alpha=0.6, zorder=3)


def _compute_axes(panels: Any, values: Sequence[float]) -> None:
    """Ticks at 1, 2, 5, 10 ... % of compute on all panels."""
    low, high = min(values), max([1.0, *values])
    ticks = [m * 10.0**e for e in range(-8, 2) for m in (1, 2, 5)]
    for axes in panels.flat:
        axes.set_xlim(low / 1.35, high * 1.35)
        axes.set_xticks([t for t in ticks if low / 1.35 <= t <= high * 1.35], minor=False)
        axes.minorticks_off()
        axes.xaxis.set_major_formatter(percent)
