"""How tables mark the policies that a robot could not run without labelled frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

MARK = "†"
"""Of policies that need ground truth."""


def marked(policy: str, needs_truth: Mapping[str, str]) -> str:
    """The policy's name, with the mark if it needs ground truth.

    Args:
        policy: its name.
        needs_truth: name of a policy → of what it needs ground truth.
    """
    return f"{policy} {MARK}" if policy in needs_truth else policy


def footnote(shown: Iterable[str], needs_truth: Mapping[str, str]) -> str:
    """What the mark means, for the policies of a table; empty where none has it.

    >>> footnote(["music", "oracle"], {"oracle": "of the route itself"})
    '† needs ground truth: oracle of the route itself.'

    Args:
        shown: names of the policies that the table shows.
        needs_truth: name of a policy → of what it needs ground truth.
    """
    needed = [f"{who} {needs_truth[who]}" for who in dict.fromkeys(shown) if who in needs_truth]
    return f"{MARK} needs ground truth: {'; '.join(needed)}." if needed else ""
