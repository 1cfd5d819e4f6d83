"""One self-contained HTML page of a comparison: sentences, tables, figures.

The page loads nothing: figures are embedded, styles are inline, there is no script. It reads on a
phone and on paper, light and dark.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from amusic_gym.estimation.settings import statistic_label
from amusic_gym.evaluation.plots import labels
from amusic_gym.policies.registry import MARK
from amusic_gym.utils.storage import write_whole

PICTURES = {b"\x89PNG\r\n": "png", b"\xff\xd8\xff": "jpeg"}
"""First bytes of a figure's file -> its type."""


@dataclass(frozen=True)
class ReportFigure:
    """A PNG or JPEG file and the sentence under it, which stands for it where it cannot be seen."""

    path: str | Path
    caption: str


def _share(value: float) -> str:
    return f"{value:.1%}"


def _number(value: float) -> str:
    return f"{value:.3f}"


def _short(value: float) -> str:
    return f"{value:.3g}"


# key of a results row -> heading, what it means, how it is written
COLUMNS: dict[str, tuple[str, str, Callable[[float], str]]] = {
    "auc": ("AUC", "area under precision-recall, over queries with a true place", _number),
    "compute": ("Compute", "seconds spent, of running every technique on every frame", _share),
    "accuracy": ("Accuracy", "share of frames whose place is right", _share),
    "ptr": ("PTR", "technique runs, of all there could be", _number),
    "seconds_per_frame": ("s / frame", "seconds of technique runs per frame", _short),
    "auc_vprbench": ("AUC, VPR-Bench", "recall relative to the correct matches", _number),
    "auc_paper": ("AUC, paper", "the same over similarity, as in the A-MuSIC paper", _number),
    "reselections": ("Re-selections", "selections after the first", _short),
    "idle": ("Idle", "share of frames on which nothing ran", _share),
    "lost": ("Lost", "share of frames in runs of at least 5 wrong ones", _share),
    "median_error": ("Median error", "places to the nearest true one", _short),
}
BARS = ("auc", "compute")  # shares of 1 that carry a bar behind the number


def write_report(
    path: str | Path,
    *,
    title: str,
    sentences: Sequence[str],
    rows: Sequence[Mapping[str, Any]],
    figures: Sequence[ReportFigure] = (),
) -> Path:
    """Write the page: the table of the first bank in `rows`, the figures, the other banks' tables.

    `sentences` stand under the title, the first one larger: say there what the numbers say.
    Put the mean rows first to have them as the summary.

    Raises:
        FileNotFoundError: a figure is not there.
        ValueError: there is no row, or a figure is no PNG file.
    """
    if not rows:
        raise ValueError("rows is empty; give at least one results row")
    banks = list(dict.fromkeys(row["bank"] for row in rows))
    tables = [_table(bank, [row for row in rows if row["bank"] == bank]) for bank in banks]
    page = PAGE.format(
        title=escape(title),
        style=STYLE,
        lead="\n".join(f"<p>{escape(sentence)}</p>" for sentence in sentences),
        summary=tables[0],
        tables="\n".join(tables[1:]),
        key="".join(f"<dt>{escape(h)}</dt><dd>{escape(m)}</dd>" for h, m, _ in COLUMNS.values()),
        figures="\n".join(_figure(figure) for figure in figures),
    )
    return write_whole(path, page.encode())


def _table(bank: str, rows: Sequence[Mapping[str, Any]]) -> str:
    name = "Mean over banks" if bank == "mean" else bank or "unnamed bank"
    costs = ", ".join(dict.fromkeys(str(row["costs"]) for row in rows))
    heads = "".join(
        f'<th scope="col" title="{escape(m)}">{escape(h)}</th>' for h, m, _ in COLUMNS.values()
    )
    frames = ", ".join(dict.fromkeys(str(row["queries"]) for row in rows))
    best = max(row["auc"] for row in rows)
    body = "\n".join(_row(row, best) for row in rows)
    return (
        f"<section><h2>{escape(name)}</h2>"
        f'<p class="note">{frames} frames; {escape(costs)} costs</p>'
        f'<div class="scroll" tabindex="0" role="region" aria-label="Results: {escape(name)}">'
        f'<table><thead><tr><th scope="col">Policy</th><th scope="col">λ</th>'
        f'<th scope="col">SIC</th>{heads}</tr></thead><tbody>\n{body}\n</tbody></table></div>'
        f"{_footnote(rows)}</section>"
    )


def _footnote(rows: Sequence[Mapping[str, Any]]) -> str:
    """What the mark means, where a policy's label has it."""
    marked = any(MARK in labels.policy_label(row["policy"]) for row in rows)
    return f'<p class="note">{MARK} needs ground truth</p>' if marked else ""


def _row(row: Mapping[str, Any], best: float) -> str:
    weight = row["compute_weight"]
    cells = "".join(_cell(key, row[key], key == "auc" and row[key] == best) for key in COLUMNS)
    kind = ' class="learned"' if weight is not None else ""
    return (
        f'<tr{kind}><th scope="row">{escape(labels.policy_label(row["policy"]))}</th>'
        f"<td>{'' if weight is None else _short(weight)}</td>"
        f"<td>{escape(statistic_label(row['statistic'], row['carry']))}</td>{cells}</tr>"
    )


def _cell(key: str, value: float | None, best: bool) -> str:
    if value is None:
        return "<td>–</td>"
    words = COLUMNS[key][2](value)
    if best:
        words = f"<strong>{words}</strong>"
    if key not in BARS:
        return f"<td>{words}</td>"
    return f'<td class="bar {key}" style="--part:{min(1.0, max(0.0, value)):.4f}">{words}</td>'


def _figure(figure: ReportFigure) -> str:
    path = Path(figure.path)
    if not path.is_file():
        raise FileNotFoundError(f"figure {path} is not there; draw it before the report")
    content = path.read_bytes()
    kind = next((name for magic, name in PICTURES.items() if content.startswith(magic)), None)
    if kind is None:
        raise ValueError(f"figure {path} is no PNG or JPEG file; write it as one of these")
    image = base64.b64encode(content).decode()
    words = escape(figure.caption)
    return (
        f'<figure><img src="data:image/{kind};base64,{image}" alt="{words}">'
        f"<figcaption>{words}</figcaption></figure>"
    )


PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main>
<header><h1>{title}</h1>
{lead}
</header>
{summary}
{figures}
{tables}
<details><summary>What the columns mean</summary><dl>{key}</dl></details>
</main>
</body>
</html>
"""

STYLE = """
:root { --paper: #fff; --ink: #1c1e21; --soft: #5d646d; --line: #d9dde2; --head: #f3f5f7;
  --auc: #cfe3f5; --compute: #f6d9c4; --learned: #d55e00; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #15181c; --ink: #e7e9ec; --soft: #a2a9b2; --line: #363c44; --head: #1f242a;
    --auc: #1f4565; --compute: #653a1d; --learned: #ff9a57; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 72rem; margin: 0 auto; padding: 1.5rem 1rem 4rem; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0 0 .8rem; }
h2 { font-size: 1.15rem; margin: 2rem 0 0; }
header p { max-width: 46rem; margin: .4rem 0; }
header p:first-of-type { font-size: 1.15rem; }
.note { color: var(--soft); font-size: .85rem; margin: .1rem 0 .5rem; }
.scroll { overflow-x: auto; border: 1px solid var(--line); border-radius: 6px; }
table { border-collapse: collapse; width: 100%; font-size: .85rem;
  font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .6rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid var(--line); }
tbody tr:last-child > * { border-bottom: 0; }
thead th { background: var(--head); font-weight: 600; vertical-align: bottom; white-space: normal; }
th:first-child { text-align: left; position: sticky; left: 0; background: var(--paper); }
thead th:first-child { background: var(--head); }
tbody th { font-weight: 500; max-width: 14rem; overflow: hidden; text-overflow: ellipsis; }
.learned th, .learned td:nth-child(2) { color: var(--learned); font-weight: 600; }
.bar { min-width: 5.5rem; background: linear-gradient(90deg, var(--fill)
  calc(100% * var(--part)), transparent 0); print-color-adjust: exact; }
.auc { --fill: var(--auc); } .compute { --fill: var(--compute); }
details { margin: 1rem 0 2rem; font-size: .9rem; color: var(--soft); }
summary { cursor: pointer; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .2rem 1rem; }
dt { font-weight: 600; } dd { margin: 0; }
figure { margin: 2rem 0; }
figure img { display: block; max-width: 100%; height: auto; background: #fff; border-radius: 6px;
  padding: 8px; border: 1px solid var(--line); }
figcaption { color: var(--soft); font-size: .9rem; margin-top: .4rem; max-width: 46rem; }
@media print {
  :root { --paper: #fff; --ink: #000; --soft: #444; --line: #bbb; --head: #f0f0f0;
    --auc: #cfe3f5; --compute: #f6d9c4; --learned: #a84a00; }
  main { max-width: none; padding: 0; }
  .scroll { overflow: visible; border: 0; }
  table { font-size: 7pt; } th, td { padding: 2pt 3pt; } .bar { min-width: 0; }
  figure, tr { break-inside: avoid; }
}
"""
