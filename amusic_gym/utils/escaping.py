"""Names written so that each medium shows them and does nothing else: terminal, Markdown, CSV.

Pages escape with `html.escape`, JSON by itself.
"""

import csv
import re
from collections.abc import Iterable
from typing import Any

# Control characters but tab and line feed, and marks that turn the direction of writing.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ufeff]")
_MARKDOWN = re.compile(r"[\\`|\[]")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def for_terminal(text: str) -> str:
    r"""``text`` with control characters shown, not obeyed.

    >>> for_terminal("\x1b[31mHOG")
    '\\x1b[31mHOG'
    """
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def for_markdown(text: str) -> str:
    r"""``text`` as the same words in Markdown, on one line.

    >>> for_markdown("<script>|a|")
    '&lt;script>\\|a\\|'
    """
    plain = " ".join(for_terminal(text).splitlines())
    plain = _MARKDOWN.sub(lambda found: f"\\{found[0]}", plain)
    return plain.replace("&", "&amp;").replace("<", "&lt;")


def for_csv(cell: Any) -> Any:
    """A cell that no spreadsheet computes: a text like a formula gets an apostrophe before it.

    >>> for_csv("=1+1"), for_csv("-1.5"), for_csv(-2)
    ("'=1+1", '-1.5', -2)
    """
    if not isinstance(cell, str):
        return cell
    cell = for_terminal(cell)
    if not cell.startswith(_FORMULA):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


class CsvWriter:
    """As `csv.writer`, with every cell through `for_csv` and lines that end in a line feed."""

    def __init__(self, file: Any) -> None:
        self._writer = csv.writer(file, lineterminator="\n")

    def writerow(self, row: Iterable[Any]) -> None:
        """Write a line."""
        self._writer.writerow([for_csv(cell) for cell in row])

    def writerows(self, rows: Iterable[Iterable[Any]]) -> None:
        """Write a line for each row."""
        for row in rows:
            self.writerow(row)
