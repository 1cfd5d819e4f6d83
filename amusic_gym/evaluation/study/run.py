"""Runs the cells of a plan that are not finished yet."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from amusic_gym.banks.bank_files import refuse_within_bank
from amusic_gym.evaluation import store
from amusic_gym.evaluation.study.cells import MEASURED, Measures
from amusic_gym.evaluation.study.plan import Plan
from amusic_gym.extraction.executors import make_executor

CELLS = "cells"

Row = dict[str, Any]

Finished = list[Row]  # for each cell of a plan, in its order: its labels and its numbers

Report = Callable[[str], None]


def run(
    plan: Plan, out: str | Path, *, executor: str = "serial", report: Report = print
) -> Finished:
    """Compute the cells that ``out`` does not hold yet, and keep each as soon as it is finished.

    The same numbers come out whatever the executor: ``serial``, ``process:N``, ``ray`` or
    ``ray:ADDRESS``. Killed at any time, it loses the cells that are running and no other.
    ``report`` is given one line per finished cell.

    Raises:
        ValueError: for an unknown executor, or an ``out`` in the folder of a bank.
        ChildProcessError: when workers die of the same cell again and again.
    """
    where = make_executor(executor)
    folder = Path(out) / CELLS
    refuse_within_bank(folder)
    folder.mkdir(parents=True, exist_ok=True)  # fails before hours of work, not after them
    done = _load(plan, folder, report)
    missing = list({cell.path: cell for cell in plan.cells if cell.path not in done}.values())
    if done:
        report(f"{len(plan.cells) - len(missing)} of {len(plan.cells)} cells were finished")
    begun, frames, seen = time.monotonic(), sum(cell.size for cell in missing), 0
    with where, where.workers(plan.bench) as workers:
        for number, (cell, measures) in enumerate(workers.run(missing), 1):
            store.save(folder, cell.path, {"measures": measures})
            done[cell.path] = measures
            seen += cell.size
            left = (time.monotonic() - begun) * (frames - seen) / seen  # at the rate so far
            report(
                f"[{number}/{len(missing)}] {cell}: auc {measures['auc']:.4f}, compute"
                f" {measures['compute']:.4f} (about {_duration(left)} left)"
            )
    return [{**cell.labels, **done[cell.path]} for cell in plan.cells]


def count_finished(
    plan: Plan, out: str | Path, report: Report = print
) -> dict[str, tuple[int, int]]:
    """Name of each policy → how many of its cells ``out`` holds, and how many there are."""
    done = _load(plan, Path(out) / CELLS, report)
    counts: dict[str, tuple[int, int]] = {}
    for cell in plan.cells:
        have, all_of_it = counts.get(cell.labels["policy"], (0, 0))
        counts[cell.labels["policy"]] = have + (cell.path in done), all_of_it + 1
    return counts


def _load(plan: Plan, folder: Path, report: Report) -> dict[str, Measures]:
    """The finished cells: file → numbers."""
    done = {}
    for path in dict.fromkeys(cell.path for cell in plan.cells):
        try:
            measures = load_measures(folder, path)
        except ValueError as error:
            report(f"{error}: computed again")
            continue
        if measures is not None:
            done[path] = measures
    return done


def load_measures(folder: Path, stem: str) -> Measures | None:
    """The numbers of a finished cell; None where there are none; a ValueError if damaged."""
    if (body := store.load(folder, stem)) is None:
        return None
    measures: Measures = body["measures"] if isinstance(body.get("measures"), dict) else {}
    plain = all(isinstance(value, int | float | None) for value in measures.values())
    if set(measures) != set(MEASURED) or not plain:
        raise store.damaged(folder, stem, "it holds other numbers than a cell's")
    return measures


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
