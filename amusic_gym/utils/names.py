"""The sentence for an unknown name, the same wherever a name is chosen."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(value: str, valid: Iterable[str]) -> str | None:
    """The valid name that is most like ``value``, ignoring case; None when none is near."""
    by_folded = {name.casefold(): name for name in reversed(list(valid))}
    close = difflib.get_close_matches(value.casefold(), list(by_folded), n=1, cutoff=0.5)
    return by_folded[close[0]] if close else None


def suggest(kind: str, value: object, valid: Iterable[str]) -> str:
    """One sentence that refuses an unknown name and shows the way.

    >>> suggest("technique", "HGO", ["HOG", "CALC"])
    "unknown technique 'HGO': did you mean 'HOG'? valid: HOG, CALC"

    Args:
        kind: what is named, for example ``"technique"``.
        value: what was given.
        valid: the names there are, in the order to list them.
    """
    names = list(valid)
    near = nearest(value, names) if isinstance(value, str) else None
    hint = f" did you mean '{near}'?" if near is not None else ""
    return f"unknown {kind} {value!r}:{hint} valid: {', '.join(names) or '(none)'}"
