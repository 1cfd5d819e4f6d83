"""The columns of tables of results, on pages and in terminals, and what each means."""

from collections.abc import Iterable
from typing import Any, NamedTuple


class Column(NamedTuple):
    """How tables show a value of a results row."""

    heading: str
    meaning: str
    form: str  # of `format`
    bar: bool = False  # whether a bar stands behind the number, a share of 1

    def words(self, value: Any) -> str:
        """The number, or the ends of an interval, as the page has it."""
        ends = value if isinstance(value, list | tuple) else [value]
        return " to ".join(format(end, self.form) for end in ends)


COLUMNS = {
    "auc": Column(
        "AUC", "area under precision-recall, over queries with a true place", ".3f", True
    ),
    "auc_interval": Column("95 %", "bootstrap interval of the AUC", ".3f"),
    "compute": Column(
        "Compute", "seconds spent, of running every technique on every frame", ".1%", True
    ),
    "accuracy": Column("Accuracy", "share of frames whose place is right", ".1%"),
    "recall_at_1": Column("R@1", "queries with a true place that have one first", ".3f"),
    "recall_at_5": Column("R@5", "that have one among the first 5 places", ".3f"),
    "recall_at_10": Column("R@10", "among the first 10", ".3f"),
    "recall_at_20": Column("R@20", "among the first 20", ".3f"),
    "recall_at_100_precision": Column("R@100%P", "recall before the first wrong match", ".3f"),
    "ptr": Column("PTR", "technique runs, of all there could be", ".3f"),
    "seconds_per_frame": Column("s / frame", "seconds of technique runs per frame", ".3g"),
    "auc_vprbench": Column("AUC, VPR-Bench", "recall relative to the correct matches", ".3f"),
    "auc_paper": Column("AUC, paper", "the same over similarity, as in the A-MuSIC paper", ".3f"),
    "reselections": Column("Re-selections", "selections after the first", ".3g"),
    "idle": Column("Idle", "share of frames on which nothing ran", ".1%"),
    "lost": Column("Lost", "share of frames in runs of at least 5 wrong ones", ".1%"),
    "median_error": Column("Median error", "places to the nearest true one", ".3g"),
}

OTHERS = {
    "λ": "compute weight of a policy that weighs compute",
    "SIC": "statistic of SIC; none: the policy gives places itself",
}
"""Heads of columns that are no numbers → what they mean."""


def legend(columns: Iterable[str]) -> str:
    """What columns of ``results.json`` mean in a table, in one paragraph; `OTHERS` first."""
    shown = {**OTHERS, **{COLUMNS[name].heading: COLUMNS[name].meaning for name in columns}}
    return ". ".join(f"{head}: {meaning}" for head, meaning in shown.items()) + "."
