"""All of the paper's experiments in one go."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from amusic_gym.evaluation.comparison import compare
from amusic_gym.evaluation.contestants import contestants
from amusic_gym.evaluation.report import write_report
from amusic_gym.evaluation.reproduction import figures, sweeps, tables
from amusic_gym.evaluation.reproduction.paper import METHODS, TECHNIQUES, TITLES
from amusic_gym.evaluation.reproduction.routes import make_route
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
    """Run the experiments on those data sets that are there; write tables, figures and a page.

    Args:
        root: the folder that holds the data sets' folders.
        out: the folder to write; what is finished there is not done again.
        datasets: of the paper's.
        weights: technique → file of weights; of the others those that ship.
        cache: see `amusic_gym.extraction.extract`.
        executor: likewise.
        report: is given one line per finished piece.

    Returns:
        The page.

    Raises:
        FileNotFoundError: if none of the data sets is there, or a file of weights is not.
        ValueError: for folders that do not match.
    """
    weights = dict(weights or {})
    names = [name.lower() for name in TECHNIQUES]
    how = {"techniques": names, "weights": weights, "cache": cache, "executor": executor}
    routes = [make_route(name, root, out / "banks", **how) for name in datasets]  # type: ignore[arg-type]
    for route in routes:
        report(f"{TITLES[route.name]}: {'; '.join(route.remarks) or 'as in the paper'}")
    banks = [route.bank for route in routes if route.bank is not None]
    if not banks:
        raise FileNotFoundError(f"none of the data sets is there: {routes[0].remarks[0]}")
    ships = [f"weights of {name} that ship" for name in SHIPS if name not in weights]
    remarks: dict[str, Sequence[str]] = dict.fromkeys(TITLES, ("not asked for",))
    remarks |= {r.name: (*r.remarks, *(ships if r.bank is not None else [])) for r in routes}

    paper = compare(
        banks, lambda _: contestants([*METHODS.values()]), out, statistic="mean", report=report
    )
    swept = compare(
        banks,
        lambda _: contestants(sweeps.ADAPTIVE),
        out / "sweep",
        statistic="mean",
        report=report,
    )
    report("Figure 3: accuracy of SIC with other K and F")
    ablated = []
    for row in sweeps.ablate(banks):
        ablated.append(row)
        report("K {candidates}, F {history}: accuracy {accuracy:.3f}".format(**row))
    cells, adapted = tables.performance(paper.traces), tables.adaptation(paper.traces)
    numbers = {"table2": cells, "table3": adapted, "ablation": ablated, "sweep": swept.mean}
    write_whole(out / "reproduction.json", json.dumps(numbers, indent=1).encode() + b"\n")

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
    drawn = [
        figures.both(
            lambda path: figures.ablation(ablated, path),
            out / "figure3.png",
            "Figure 3: what K and F of SIC do; the mean over data sets and techniques.",
        ),
        figures.both(
            lambda path: figures.accuracies(cells, path),
            out / "figure4.png",
            "Figure 4: accuracy of the techniques, pale alone and full with SIC.",
        ),
        *figures.drives(paper.traces, out),
        figures.both(
            lambda path: figures.sweep(swept.mean, path),
            out / "sweep.png",
            "A-MuSIC with other E and M than the paper's .7 and 10; the mean over data sets.",
        ),
    ]
    there = ", ".join(TITLES[bank.name] for bank in banks)
    return write_report(
        out / "index.html",
        title="The paper's experiments, run again",
        sentences=[f"Ours on {there}, beside what the paper says."],
        rows=[*paper.mean, *paper.rows],
        figures=drawn,
        traces=paper.traces,
        images=paper.images,
        highlights=[
            (f"A-MuSIC on {TITLES[trace.bank]}", trace)
            for trace in paper.traces
            if trace.policy == METHODS["A-MuSIC"]
        ],
        tables=shown,
    )
