"""The figures of a comparison, as PNG files, and its page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from amusic_gym.evaluation.audit import PARTING, audit
from amusic_gym.evaluation.comparison import Comparison, rows_by_bank, spread
from amusic_gym.evaluation.plots import labels
from amusic_gym.evaluation.report import ReportFigure, write_report
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.registry import BOUND, LEARNED, parse
from amusic_gym.policies.trace import Trace
from amusic_gym.utils.names import distinct, file_stem
from amusic_gym.utils.storage import keep_only

MOST_CURVES = 16  # in a figure; of more the subsets are left out, then the last
MOST_SHADES = 3  # λ of one policy in a figure of curves
MOST_PANELS = 8  # traces in a figure of selections
NEAR = 0.02  # difference of AUC that a headline passes over
DRAWN = ("front", "selections")  # figures that the page's script draws itself


def draw(comparison: Comparison, folder: str | Path) -> list[ReportFigure]:
    """Write the figures of a comparison as PNG files to ``folder``; those of an earlier one go.

    Per bank: AUC against compute, precision-recall curves, and the runs along the route of the
    policies that vary them; over all banks: the mean front, and the shares of MuSIC's choices.
    """
    from amusic_gym.evaluation import plots

    folder = Path(folder)
    figures = []
    groups = rows_by_bank(comparison.rows)
    if len(groups) > 1 and _has_front(comparison.mean):
        path = plots.front(comparison.mean, folder / "front-mean.png")
        figures.append(ReportFigure(path, "AUC against compute, mean over all routes."))
    stems = distinct([file_stem(bank) for bank in groups], taken=("mean",))
    for (bank, rows), stem in zip(groups.items(), stems, strict=True):
        traces = [trace for trace in comparison.traces if trace.bank == bank]
        if _has_front(rows):
            path = plots.front(rows, folder / f"front-{stem}.png")
            figures.append(ReportFigure(path, f"AUC against compute on {bank}."))
        path = plots.precision_recall(_curves(traces), folder / f"precision_recall-{stem}.png")
        figures.append(ReportFigure(path, f"Precision-recall curves on {bank}."))
        if panels := _panels(traces):
            path = plots.selections(panels, folder / f"selections-{stem}.png")
            figures.append(ReportFigure(path, f"Techniques run along the route of {bank}."))
    if trusted := _trusted(comparison.traces):
        path = plots.shares(trusted, folder / "shares.png")
        figures.append(ReportFigure(path, "Shares of MuSIC's choices on each route."))
    keep_only(folder, "figures", [figure.path for figure in figures])
    return figures


def headline(rows: Sequence[Mapping[str, Any]]) -> str:
    """The highest AUC of a bank's rows in one sentence, and the cheapest within `NEAR` of it."""
    shown = [row for row in rows if parse(row["policy"]).policy.family != BOUND]
    best = min(shown, key=lambda row: (-round(row["auc"], 3), *_price(row)))
    near = min((row for row in shown if row["auc"] >= best["auc"] - NEAR), key=_price)
    cheaper = f"{_named(near)} comes within {NEAR} of it at {near['compute']:.0%}"
    if near is best:
        cheaper = f"nothing cheaper comes within {NEAR} of it"
    return (
        f"Of {len(shown)} policies, {_named(best)} has the highest AUC, {best['auc']:.3f}, at"
        f" {best['compute']:.0%} of the compute of all techniques; {cheaper}."
    )


def _price(row: Mapping[str, Any]) -> tuple[float, bool]:
    """What a policy costs; of equals a rule goes before a trained selector that does as much."""
    return round(row["compute"], 3), parse(row["policy"]).policy.family == LEARNED


def write_page(comparison: Comparison, folder: str | Path) -> Path:
    """Draw the figures, and write ``index.html``, whose script draws fronts and routes itself."""
    several = len({row["bank"] for row in comparison.rows}) > 1
    rows = [*(comparison.mean if several else []), *comparison.rows]
    return write_report(
        Path(folder) / "index.html",
        title=f"Policies on {', '.join(dict.fromkeys(row['bank'] for row in comparison.rows))}",
        sentences=[headline([row for row in rows if row["bank"] == rows[0]["bank"]])],
        rows=rows,
        figures=of_page(draw(comparison, folder)),
        traces=comparison.traces,
        images=comparison.images,
        below=believed(comparison.traces),
    )


def of_page(figures: Sequence[ReportFigure]) -> list[ReportFigure]:
    """Those that the page's script does not draw itself."""
    return [each for each in figures if not Path(each.path).name.startswith(DRAWN)]


def believed(traces: Sequence[Trace]) -> list[Table]:
    """The drives on which mean p̂ and accuracy differ by more than `PARTING`, as a table or none."""
    audits = [(trace, held) for trace in traces if (held := audit(trace)) is not None]
    rows = [
        [labels.trace_label(trace), trace.bank]
        + [f"{value:.3f}" for value in (held.p_correct, held.accuracy, held.gap)]
        for trace, held in sorted(audits, key=lambda pair: -abs(pair[1].gap))
        if abs(held.gap) > PARTING
    ]
    heads = ["policy", "route", "mean p̂", "accuracy", "difference"]
    title = f"Estimated correctness p̂ is off by more than {PARTING:g}: {len(rows)} of {len(audits)}"
    return [Table(title, heads, rows, words=2)] if rows else []


def _named(row: Mapping[str, Any]) -> str:
    weight = row["compute_weight"]
    return labels.row_label(row) + ("" if weight is None else f", {labels.weight_label(weight)}")


def _has_front(rows: Sequence[dict[str, Any]]) -> bool:
    return any(parse(row["policy"]).policy.charted for row in rows)


def _curves(traces: Sequence[Trace]) -> list[Trace]:
    """The traces that a figure of curves can hold: of many λ a few, of many policies no subsets."""
    for policy in dict.fromkeys(trace.policy for trace in traces):
        own = [trace for trace in traces if trace.policy == policy]
        dropped = {id(each) for each in own} - {id(each) for each in spread(own, MOST_SHADES)}
        traces = [trace for trace in traces if id(trace) not in dropped]
    if len(traces) <= MOST_CURVES:
        return list(traces)
    return ([trace for trace in traces if not _is_subset(trace)] or list(traces))[:MOST_CURVES]


def _panels(traces: Sequence[Trace]) -> list[Trace]:
    """Traces whose choice of techniques varies; of many λ an even spread."""
    varied = [trace for trace in traces if not parse(trace.policy).policy.constant]
    plain = [trace for trace in varied if trace.compute_weight is None]
    swept = [trace for trace in varied if trace.compute_weight is not None]
    room = max(1, MOST_PANELS - len(plain))
    chosen = [*plain[:MOST_PANELS], *spread(swept, room)]
    return [trace for trace in varied if any(trace is other for other in chosen)]


def _trusted(traces: Sequence[Trace]) -> list[Trace]:
    """MuSIC's trace on each bank; else those of a policy like it."""
    for policy in ("music", "amusic", "amusic:evidence"):
        if found := [trace for trace in traces if trace.policy == policy]:
            return found
    return []


def _is_subset(trace: Trace) -> bool:
    """Whether it is of a fixed subset of several techniques, but not of all."""
    policy, argument = parse(trace.policy)
    return policy.colour is None and argument not in trace.techniques
