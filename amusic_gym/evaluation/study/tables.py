"""The findings of a study as tables: text for a terminal, markdown for the documentation."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from amusic_gym.estimation.settings import statistic_label
from amusic_gym.evaluation.audit import PARTING
from amusic_gym.evaluation.plots.labels import policy_label
from amusic_gym.evaluation.study.cells import CONDITIONS
from amusic_gym.evaluation.study.findings import SHOWN_COMPUTES, Findings, ahead
from amusic_gym.evaluation.study.fronts import BAND, ROUNDING
from amusic_gym.evaluation.study.plan import MEAN
from amusic_gym.evaluation.study.run import Row
from amusic_gym.evaluation.tables import Table, footnote, marked
from amusic_gym.policies.registry import FRONTS
from amusic_gym.utils.escaping import for_markdown
from amusic_gym.utils.storage import write_whole

TABLES = "tables.md"


def tables(findings: Findings) -> list[Table]:
    """All tables: the mean over routes first, then every route."""
    routes = [route["bank"] for route in findings.routes]
    scopes = [*([MEAN] if len(routes) > 1 else []), *routes]
    made = [_points(findings, scope) for scope in scopes]
    conditions = findings.settings["conditions"]
    made += [_fronts(findings, condition) for condition in conditions]
    for scope in scopes if findings.matches else []:
        made += [matches_table(findings, condition, scope) for condition in conditions]
    if findings.margins:
        made.append(_margins(findings))
    if findings.audit:
        made.append(audit_table(findings, findings.audit))
    return made


def text(findings: Findings) -> str:
    """The tables and, at the end, the warnings."""
    blocks = [table.text() for table in tables(findings)]
    return "\n\n".join([*blocks, *(["\n".join(findings.warnings)] if findings.warnings else [])])


def write_markdown(findings: Findings, folder: str | Path) -> Path:
    """Write `TABLES`, of which each part may be copied into the documentation."""
    blocks = [table.markdown() for table in tables(findings)]
    if findings.warnings:
        blocks.append("\n".join(f"- **{for_markdown(line)}**" for line in findings.warnings))
    return write_whole(Path(folder) / TABLES, ("\n\n".join(blocks) + "\n").encode())


def _points(findings: Findings, scope: str) -> Table:
    """Every policy and λ on one route or over all, each condition in columns of its own."""
    conditions = findings.settings["conditions"]
    by_key: dict[tuple[Any, ...], dict[str, Row]] = {}
    for row in findings.points:
        if row["bank"] == scope:
            label = statistic_label(row["statistic"], row["carry"])
            key = row["policy"], row["compute_weight"], label
            by_key.setdefault(key, {})[row["condition"]] = row
    heads = ["policy", "λ", "SIC"]
    for condition in conditions:
        heads += [f"AUC {CONDITIONS[condition]}", "95 %", "compute", "accuracy"]
        heads += ["gap closed"] if scope == MEAN else []
    rows = [
        [_marked(findings, policy), "" if weight is None else f"{weight:g}", statistic]
        + [cell for condition in conditions for cell in _point_cells(of[condition], scope)]
        for (policy, weight, statistic), of in by_key.items()
    ]
    return Table(_title(findings, scope), heads, rows, _points_note(findings, scope), words=3)


def _point_cells(row: Row, scope: str) -> list[str]:
    cells = [
        f"{row['auc']:.3f}",
        _interval(row["auc_interval"]),
        percent(row["compute"]),
        f"{row['accuracy']:.3f}",
    ]
    return [*cells, _maybe(row["gap_closed"], percent)] if scope == MEAN else cells


def _title(findings: Findings, scope: str) -> str:
    costs = findings.settings["costs"]
    if scope == MEAN:
        return f"Mean over {len(findings.routes)} routes ({costs} costs)"
    route = next(route for route in findings.routes if route["bank"] == scope)
    return f"{scope}: {route['queries']} frames, {route['references']} places ({costs} costs)"


def _points_note(findings: Findings, scope: str) -> str:
    rows = [row for row in findings.points if row["bank"] == scope]
    over = next((row["interval_over"] for row in rows), "")
    count = len(findings.settings["seeds"])
    parts = [
        f"Means over {count} seeds; 95 % bootstrap intervals over {over}, empty where there is "
        "nothing to resample."
    ]
    if scope == MEAN:
        here, anywhere = ({row["policy"] for row in of} for of in (rows, findings.points))
        left_out = len(anywhere - here)
        parts += [f"{left_out} policies that are not on every route are left out."] * bool(left_out)
        parts.append(
            "Gap closed: share of the way from the single best to the virtual best fixed subset, "
            "both within the same compute."
        )
    return noted(findings, " ".join(parts), [row["policy"] for row in rows])


def _fronts(findings: Findings, condition: str) -> Table:
    """The fronts of every route and their mean: hypervolume and AUC at some computes."""
    heads = ["route", "front", "hypervolume", "95 %", "begins at"]
    heads += [f"≤ {compute:.0%}" for compute in SHOWN_COMPUTES]
    shown = [
        row
        for row in findings.fronts
        if row["condition"] == condition and row["begins"] < 1.0 - ROUNDING
    ]
    rows = [[row["bank"], _marked(findings, row["front"]), *front_cells(row)] for row in shown]
    note = (
        "A front is the best AUC at no more than that compute. Hypervolume: its area above AUC 0.5 "
        "over log compute, from the cheapest technique's compute to 1, as a share of the greatest "
        "there could be. Policies that always run everything have none and are left out."
    )
    note = noted(findings, note, [row["front"] for row in shown])
    return Table(f"Fronts, {CONDITIONS[condition]}", heads, rows, note, words=2)


def front_cells(row: Row) -> list[str]:
    """Of a front: hypervolume, its interval, where it begins, AUC at `SHOWN_COMPUTES`."""
    return [
        _maybe(row["hypervolume"], three),
        _interval(row["hypervolume_interval"]),
        percent(row["begins"]),
        *(_maybe(value, three) for value in row["auc_at"]),
    ]


def matches_table(findings: Findings, condition: str, scope: str = MEAN) -> Table:
    """Every point of the learned selectors, and the best rival of each kind at no more compute."""
    here = (condition, scope)
    shown = [row for row in findings.matches if (row["condition"], row["bank"]) == here]
    points = {
        (row["policy"], row["compute_weight"]): row["auc_interval"]
        for row in findings.points
        if (row["condition"], row["bank"]) == here
    }
    matched: dict[tuple[Any, ...], dict[str, Row]] = {}
    for row in shown:
        matched.setdefault((row["policy"], row["compute_weight"]), {})[row["kind"]] = row
    found = {row["kind"] for row in shown}
    against = [kind for kind in (*FRONTS.values(), *findings.settings["rivals"]) if kind in found]
    rows = []
    for (policy, weight), of in matched.items():
        own = next(iter(of.values()))
        start = [_marked(findings, policy), "" if weight is None else f"{weight:g}"]
        start += [percent(own["compute"]), three(own["auc"]), _interval(points[policy, weight])]
        rows.append([*start, *(_rival(of.get(kind)) for kind in against)])
    where = f"mean over {len(findings.routes)} routes" if scope == MEAN else scope
    title = f"The best of each kind at no more compute, {CONDITIONS[condition]}: {where}"
    note = (
        "Each column: the best AUC of its kind at no more compute than the selector's, and whose "
        "it is. =: level with the selector, the 95 % bootstrap interval of the difference holds "
        "0; >: ahead of it. –: none is so cheap. In the last column nothing may run on a frame."
    )
    heads = ["selector", "λ", "compute", "AUC", "95 %", *against]
    return Table(title, heads, rows, noted(findings, note, [row["policy"] for row in shown]))


def _rival(match: Row | None) -> str:
    """A rival's AUC, how it stands to the selector, and its name."""
    if match is None or match["rival"] is None:
        return "–"
    sign = {None: " =", True: "", False: " >"}[ahead(match)]
    return f"{match['rival_auc']:.3f}{sign} ({rival_label(match)})"


def rival_label(match: Row) -> str:
    """The rival of a row of `Findings.matches` and its λ, if it has one."""
    weight = "" if match["rival_weight"] is None else f", λ {match['rival_weight']:g}"
    return policy_label(match["rival"]) + weight


def _margins(findings: Findings) -> Table:
    """How far every learned selector is above or below its rivals."""
    low, high = (f"{compute:.0%}" for compute in BAND)
    heads = ["route", "condition", "selector", "against", "least", "at", f"greatest {low}–{high}"]
    heads += ["at", "95 %", "begins", "rival begins"]
    rows = [
        [
            row["bank"],
            CONDITIONS[row["condition"]],
            _marked(findings, row["policy"]),
            _marked(findings, row["rival"]),
            _maybe(row["least"], _signed),
            _maybe(row["least_at"], percent),
            _maybe(row["greatest"], _signed),
            _maybe(row["greatest_at"], percent),
            _interval(row["greatest_interval"], _signed),
            percent(row["begins"]),
            percent(row["rival_begins"]),
        ]
        for row in findings.margins
    ]
    note = (
        "Least and greatest difference over a fixed grid of computes, where both fronts have "
        "begun; a rival that begins earlier has the computes below for itself."
    )
    note = noted(
        findings, note, [row[key] for row in findings.margins for key in ("policy", "rival")]
    )
    return Table("Margins: AUC of the selector's front minus the rival's", heads, rows, note, 4)


def audit_table(findings: Findings, shown: Sequence[Row]) -> Table:
    """p̂ against the truth, of rows of the audit."""
    heads = ["policies", "condition", "route", "mean p̂", "accuracy", "p̂ − accuracy", "greatest"]
    heads += ["of", "AUROC", "least", "ECE", "greatest"]
    rows = [
        [
            _marked(findings, row["front"]),
            CONDITIONS[row["condition"]],
            row["bank"],
            three(row["p_correct"]),
            three(row["accuracy"]),
            _signed(row["gap"]),
            _signed(row["greatest_gap"]),
            row["greatest_gap_of"],
            _maybe(row["auroc"], three),
            _maybe(row["least_auroc"], three),
            three(row["calibration_error"]),
            three(row["greatest_calibration_error"]),
        ]
        for row in shown
    ]
    note = (
        "Means over cells, and the worst cell. A warning where p̂ is above the accuracy by more "
        f"than {PARTING:g}."
    )
    note = noted(findings, note, [row["front"] for row in shown])
    return Table("Audit: estimated correctness p̂ against the truth", heads, rows, note, words=3)


def _marked(findings: Findings, policy: str) -> str:
    return marked(policy, findings.settings["needs_truth"])


def noted(findings: Findings, note: str, shown: Sequence[str]) -> str:
    """The note, and what the mark means if one of these policies has it."""
    return " ".join(filter(None, [note, footnote(shown, findings.settings["needs_truth"])]))


def three(value: float) -> str:
    """An AUC or a share, to three digits."""
    return f"{value:.3f}"


def _signed(value: float) -> str:
    return f"{value:+.3f}"


def percent(value: float) -> str:
    """A share of the compute."""
    return f"{100 * value:.1f} %"


def _maybe(value: float | None, words: Callable[[float], str]) -> str:
    return "–" if value is None else words(value)


def _interval(ends: Sequence[float] | None, words: Callable[[float], str] = three) -> str:
    return "" if ends is None else f"{words(ends[0])} … {words(ends[1])}"
