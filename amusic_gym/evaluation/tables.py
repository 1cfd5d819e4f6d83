"""Tables as text and markdown, and their mark of policies that need ground truth."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

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
