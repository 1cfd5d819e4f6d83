"""All of the paper's experiments in one go."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from amusic_gym.evaluation.comparison import compare
from amusic_gym.evaluation.contestants import contestants
from amusic_gym.evaluation.report import ReportFigure, write_report
from amusic_gym.evaluation.reproduction import figures, sweeps, tables
from amusic_gym.evaluation.reproduction.paper import METHODS, TECHNIQUES, TITLES
from amusic_gym.evaluation.reproduction.routes import extracted, joined, load
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.trace import Trace
from amusic_gym.techniques import make_technique
from amusic_gym.utils.storage import write_whole

SHIPS = ("calc", "netvlad")
"""Techniques whose weights, unless given, are those that ship and not the paper's."""


def reproduce(
    root: str | os.PathLike[str],
    out: Path,
    *,
    datasets: Sequence[str] = tuple(TITLES),
    weights: Mapping[str, str] | None = None,
    cache: str | os.PathLike[str] | None = None,
    executor: str = "serial",
    report: Callable[[str], None] = print,
) -> Path:
    """Run the experiments on those data sets that are there; write tables, figures and the page.

    What is finished in ``out`` is not done again.

    Args:
        root: the folder that holds the data sets' folders.
        out: the folder to write.
        datasets: of the paper's.
        weights: technique → file of weights; of the others those that ship.
        cache: see `amusic_gym.extraction.extract`.
        executor: likewise.
        report: is given one line per finished piece.

    Raises:
        FileNotFoundError: if none of the data sets is there, or a file of weights is not.
        ValueError: for folders that do not match.
    """
    weights = dict(weights or {})
    ships = [f"weights of {name} that ship" for name in SHIPS if name not in weights]
    remarks: dict[str, Sequence[str]] = dict.fromkeys(TITLES, ("not asked for",))
    there = []
    for name in datasets:  # before hours of work
        try:
            found, differs = load(name, root)
            there.append(found)
            remarks[name] = [*differs, *ships]
        except FileNotFoundError as error:
            remarks[name] = [str(error)]
        report(f"{TITLES[name]}: {'; '.join(remarks[name]) or 'as in the paper'}")
    if not there:
        raise FileNotFoundError(f"none of the data sets is there: {remarks[datasets[0]][0]}")
    techniques = [make_technique(name, weights.get(name)) for name in map(str.lower, TECHNIQUES)]
    bank_of = partial(
        extracted, out=out / "banks", techniques=techniques, cache=cache, executor=executor
    )
    banks = [bank_of(found) for found in there]

    run = partial(compare, statistic="mean", report=report)
    methods = contestants([*METHODS.values()])
    paper = run(banks, lambda _: methods, out)
    drive = []  # of a single data set there is none
    if len(there) > 1:
        whole = bank_of(joined(there))
        drive = run([whole], lambda _: methods, out / whole.name).traces
    swept = run(banks, lambda _: contestants(sweeps.ADAPTIVE), out / "sweep")
    report("Figure 3: accuracy of SIC with other K and F")
    ablated = []
    for row in sweeps.ablate(banks):
        ablated.append(row)
        report("K {candidates}, F {history}: accuracy {accuracy:.3f}".format(**row))
    traces = [*paper.traces, *drive]
    cells, adapted = tables.performance(traces), tables.adaptation(traces)
    numbers = {"table2": cells, "table3": adapted, "ablation": ablated, "sweep": swept.mean}
    write_whole(out / "reproduction.json", json.dumps(numbers, indent=1).encode() + b"\n")

    shown = _write_tables(cells, adapted, remarks, out, report)
    return write_report(
        out / "index.html",
        title="The paper's experiments, run again",
        sentences=[
            f"Ours on {', '.join(TITLES[bank.name] for bank in banks)}, beside what the paper says."
        ],
        rows=[*paper.mean, *paper.rows],
        figures=[
            *_draw(ablated, cells, paper.traces, swept.mean, out),
            *(figures.one_drive(drive, there, out) if drive else []),
        ],
        traces=paper.traces,
        images=paper.images,
        highlights=[
            (f"A-MuSIC on {TITLES[trace.bank]}", trace)
            for trace in paper.traces
            if trace.policy == METHODS["A-MuSIC"]
        ],
        tables=shown,
    )


def _write_tables(
    cells: tables.Cells,
    adapted: Mapping[str, Mapping[str, float]],
    remarks: Mapping[str, Sequence[str]],
    out: Path,
    report: Callable[[str], None],
) -> list[Table]:
    """Tables II and III and the remarks: reported, and written as Markdown, CSV and LaTeX."""
    made = {
        "table2": tables.table_two(cells),
        "table2-milliseconds": tables.table_times(cells),
        "table3": tables.table_three(adapted),
    }
    for name, table in made.items():
        write_whole(out / f"{name}.csv", tables.to_csv(table))
        write_whole(out / f"{name}.tex", tables.to_latex(table))
        report(f"\n{table.text()}")
    shown = [*made.values(), tables.remarks_table(remarks)]
    report(f"\n{shown[-1].text()}")
    text = "\n\n".join(table.markdown() for table in shown)
    write_whole(out / "tables.md", text.encode() + b"\n")
    return shown


def _draw(
    ablated: figures.Rows,
    cells: tables.Cells,
    traces: Sequence[Trace],
    swept: figures.Rows,
    out: Path,
) -> list[ReportFigure]:
    return [
        figures.both(
            figures.ablation,
            ablated,
            out / "figure3.png",
            "Figure 3: what K and F of SIC do; the mean over data sets and techniques.",
        ),
        figures.both(
            figures.accuracies,
            cells,
            out / "figure4.png",
            "Figure 4: accuracy of the techniques, pale alone and full with SIC.",
        ),
        *figures.drives(traces, out),
        figures.both(
            figures.sweep,
            swept,
            out / "sweep.png",
            "A-MuSIC with other E and M than the paper's .7 and 10; the mean over data sets.",
        ),
    ]
