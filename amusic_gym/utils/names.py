"""Names: the sentence for an unknown one, and those of files and of what must be told apart."""

import difflib
from collections.abc import Iterable, Sequence


def nearest(value: str, valid: Iterable[str]) -> str | None:
    """The valid name that is most like ``value``, ignoring case; None when none is near."""
    by_folded = {name.casefold(): name for name in reversed(list(valid))}
    close = difflib.get_close_matches(value.casefold(), list(by_folded), n=1, cutoff=0.5)
    return by_folded[close[0]] if close else None


def suggest(kind: str, value: object, valid: Iterable[str]) -> str:
    """One sentence that refuses an unknown name and shows the way.

    >>> suggest("technique", "HGO", ["HOG", "CALC"])
    "unknown technique 'HGO': did you mean 'HOG'? valid: HOG, CALC"
    """
    names = list(valid)
    near = nearest(value, names) if isinstance(value, str) else None
    hint = f" did you mean '{near}'?" if near is not None else ""
    return f"unknown {kind} {value!r}:{hint} valid: {', '.join(names) or '(none)'}"


def distinct(names: Sequence[str], taken: Iterable[str] = ()) -> list[str]:
    """The names, a repeated or taken one with the next free number: "bank", "bank (2)".

    They differ in more than case, so that files can be named after them anywhere.
    """
    used = {name.casefold() for name in taken}
    given = []
    for name in names:
        number, candidate = 1, name
        while candidate.casefold() in used:
            number += 1
            candidate = f"{name} ({number})"
        used.add(candidate.casefold())
        given.append(candidate)
    return given


def few(items: Sequence[str], most: int, between: str = ", ") -> str:
    """The first of some items, and how many more there are.

    >>> few(["a", "b", "c", "d"], 2)
    'a, b and 2 more'
    """
    rest = f"{between.strip(', ')} and {len(items) - most} more" if len(items) > most else ""
    return between.join(items[:most]) + rest


def file_stem(name: str) -> str:
    """A name as part of a file's name on any system: letters, digits and ``-_.+``, not long."""
    safe = "".join(c if c.isalnum() or c in "-_.+" else "_" for c in name).strip("._").encode()
    short = safe if len(safe) <= 80 else safe[:39] + b"__" + safe[-39:]  # systems count bytes
    return short.decode(errors="ignore") or "unnamed"
