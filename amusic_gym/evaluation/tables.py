"""Tables as text and markdown, what their columns mean, and the mark of what needs ground truth."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from amusic_gym.policies.registry import MARK
from amusic_gym.utils.escaping import for_markdown


@dataclass(frozen=True)
class Table:
    """Words in rows; the first ``words`` columns are text, the others numbers."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    words: int = 1

    def text(self) -> str:
        """For a terminal."""
        lines = [self.heads, *self.rows]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        shown = [self.title] if self.title else []
        for line in lines:
            cells = [
                cell.ljust(width) if i < self.words else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(line, widths, strict=True))
            ]
            shown.append("  ".join(cells).rstrip())
        return "\n".join([*shown, *([self.note] if self.note else [])])

    def markdown(self) -> str:
        """A heading, the table and its note."""
        ends = [":--" if i < self.words else "--:" for i in range(len(self.heads))]
        lines = [self.heads, ends, *self.rows]
        body = "\n".join(f"| {' | '.join(map(for_markdown, line))} |" for line in lines)
        blocks = [f"### {for_markdown(self.title)}", body, for_markdown(self.note)]
        return "\n\n".join(filter(None, blocks))


def marked(policy: str, needs_truth: Mapping[str, str]) -> str:
    """The policy's name, with the mark if ``needs_truth`` says of what it needs ground truth."""
    return f"{policy} {MARK}" if policy in needs_truth else policy


def footnote(shown: Iterable[str], needs_truth: Mapping[str, str]) -> str:
    """What the mark means, for the policies of a table; empty where none has it.

    >>> footnote(["music", "oracle"], {"oracle": "of the route itself"})
    '† has seen ground truth: oracle of the route itself.'
    """
    needed = [f"{who} {needs_truth[who]}" for who in dict.fromkeys(shown) if who in needs_truth]
    return f"{MARK} has seen ground truth: {'; '.join(needed)}." if needed else ""


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
