"""Tables II and III beside the paper's figures: as words, CSV and LaTeX in the paper's layout."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from amusic_gym.banks.costs import paper_seconds
from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.reproduction.paper import METHODS, TITLES, figures
from amusic_gym.evaluation.reproduction.routes import ONE_DRIVE
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.trace import Trace

MISSING = "–"
TOGETHER = "in one drive"
DIGITS = {"ptr": 2, "technique_runs": 0, "re_selections": 0}

Cells = dict[str, dict[str, dict[str, float]]]  # data set → method → number by name


def performance(traces: Sequence[Trace]) -> Cells:
    """AUC and milliseconds per frame (table II), of our own runs.

    ``auc`` in the paper's own measure; ``milliseconds`` by the costs of the traces,
    ``milliseconds_paper`` by what the paper's techniques took.
    """
    names = {policy: method for method, policy in METHODS.items()}
    cells: Cells = {}
    for trace in traces:
        runs = trace.runs.sum(axis=0) / trace.queries
        cells.setdefault(trace.bank, {})[names[trace.policy]] = {
            "auc": metrics.auc_paper(trace),
            "accuracy": float(trace.correct.mean()),
            "milliseconds": 1e3 * float(runs @ trace.seconds),
            "milliseconds_paper": 1e3 * float(runs @ paper_seconds(trace.techniques)),
        }
    return cells


def adaptation(traces: Sequence[Trace]) -> dict[str, dict[str, float]]:
    """PTR, technique runs and re-selections of A-MuSIC by data set (table III)."""
    return {
        trace.bank: {
            "ptr": metrics.ptr(trace),
            "technique_runs": int(trace.runs.sum()),
            "re_selections": metrics.reselections(trace),
        }
        for trace in traces
        if trace.policy == METHODS["A-MuSIC"]
    }


def table_two(cells: Cells) -> Table:
    """Ours / the paper's AUC for each method and data set, their mean, and ours in one drive."""
    paper = figures()["auc"]
    rows = []
    for method in METHODS:
        ours = {name: cells[name][method]["auc"] for name in _found(cells)}
        shown = [_pair(ours.get(name), paper[name][method], 2) for name in TITLES]
        theirs = [paper[name][method] for name in ours]
        mean = _pair(float(np.mean(list(ours.values()))), float(np.mean(theirs)), 2)
        drive = [f"{cells[ONE_DRIVE][method]['auc']:.2f}"] if ONE_DRIVE in cells else []
        rows.append([method, *shown, mean, *drive])
    note = f"Ours / the paper's; the mean is over the {len(_found(cells))} data sets that are there"
    heads = ["method", *TITLES.values(), "mean"]
    if ONE_DRIVE not in cells:
        return Table("Table II: AUC", heads, rows, f"{note}.")
    note += ", which are joined on one map in the last column."
    return Table("Table II: AUC", [*heads, TOGETHER], rows, note)


def table_times(cells: Cells) -> Table:
    """Milliseconds per frame: measured, by the paper's costs, the paper's; means of data sets."""
    paper, names = figures()["milliseconds"], _found(cells)
    rows = []
    for method in METHODS:
        ours = [
            float(np.mean([cells[name][method][key] for name in names]))
            for key in ("milliseconds", "milliseconds_paper")
        ]
        theirs = float(np.mean([paper[name][method] for name in names]))
        rows.append([method, *(f"{value:.1f}" for value in (*ours, theirs))])
    heads = ["method", "measured", "at the paper's costs", "paper"]
    note = "Ours without the time of SIC, which figure 3 has."
    return Table("Table II: milliseconds per frame", heads, rows, note)


def table_three(ours: Mapping[str, Mapping[str, float]]) -> Table:
    """PTR, runs and re-selections of A-MuSIC: ours / the paper's; in one drive ours only."""
    paper = figures()["adaptation"]
    titles = {**TITLES, **({ONE_DRIVE: TOGETHER} if ONE_DRIVE in ours else {})}
    rows = [
        [
            title,
            *(
                _pair(ours.get(name, {}).get(key), paper.get(name, {}).get(key), digits)
                for key, digits in DIGITS.items()
            ),
        ]
        for name, title in titles.items()
    ]
    heads = ["data set", "PTR", "technique runs", "re-selections"]
    return Table("Table III: A-MuSIC", heads, rows, "Ours / the paper's.")


def _found(cells: Cells) -> list[str]:
    """Those data sets of the paper that are there, in its order."""
    return [name for name in TITLES if name in cells]


def _pair(ours: float | None, paper: float | None, digits: int) -> str:
    return " / ".join(MISSING if each is None else f"{each:.{digits}f}" for each in (ours, paper))


def to_csv(table: Table) -> bytes:
    """The table as CSV; ours and the paper's of one cell in two columns."""
    text = io.StringIO()
    writer = csv.writer(text)
    halves = [["", " (paper)"] if " / " in cell else [""] for cell in table.rows[0]]
    heads = [h + end for h, ends in zip(table.heads, halves, strict=True) for end in ends]
    writer.writerow(heads)
    for row in table.rows:
        values = [part for cell in row for part in cell.split(" / ")]
        writer.writerow(["" if value == MISSING else value for value in values])
    return text.getvalue().encode()


def to_latex(table: Table) -> bytes:
    """The table as a LaTeX tabular in the paper's layout; the paper's figure in brackets."""
    lines = [
        rf"% {table.title}. {table.note}",
        rf"\begin{{tabular}}{{|c|{'c' * (len(table.heads) - 1)}|}}",
        r"\hline",
        " & ".join(rf"\textbf{{{head}}}" for head in table.heads) + r" \\",
        r"\hline",
        *(
            " & ".join(_bracketed(cell) for cell in row).replace(MISSING, "--") + r" \\"
            for row in table.rows
        ),
        r"\hline",
        r"\end{tabular}",
    ]
    return ("\n".join(lines) + "\n").encode()


def _bracketed(cell: str) -> str:
    ours, slash, paper = cell.partition(" / ")
    return f"{ours} ({paper})" if slash else cell


def remarks_table(remarks: Mapping[str, Sequence[str]]) -> Table:
    """What differs from the paper, by data set."""
    rows: list[Any] = [
        [TITLES[name], "; ".join(remarks[name]) or "as in the paper"] for name in TITLES
    ]
    return Table("What differs from the paper", ["data set", "remark"], rows, words=2)
