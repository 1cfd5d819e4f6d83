"""File names of a traverse: their natural order, and numbers that are missing or used twice."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import PurePath

_DIGITS = re.compile(r"([0-9]+)")
_LAST_NUMBER = re.compile(r"(.*?)([0-9]+)([^0-9]*)", re.DOTALL)

NaturalKey = tuple[tuple[str | int, ...], str]


def natural_key(text: str) -> NaturalKey:
    """Sort key by which img2 comes before img10; upper and lower case only break ties.

    >>> sorted(["img10", "IMG2", "img1"], key=natural_key)
    ['img1', 'IMG2', 'img10']
    """
    # Splitting at groups of digits puts text at even places and digits at odd ones, always.
    pieces = _DIGITS.split(text.casefold())
    return tuple(int(piece) if at % 2 else piece for at, piece in enumerate(pieces)), text


def path_key(path: PurePath) -> tuple[NaturalKey, ...]:
    """Sort key of a path: its folders and its name naturally; the name without suffix first."""
    return (*map(natural_key, path.parts[:-1]), natural_key(path.stem), natural_key(path.suffix))


def gaps(paths: Sequence[PurePath]) -> list[int]:
    """After which paths numbers are missing: i stands for a gap between paths i and i + 1.

    The number of a path is the last one in its name. Paths whose names are the same but for the
    number are one series; 10, 20, 30 is a series without gaps, because its usual step is 10. Where
    less than half the steps are the usual one, the numbers are no frame numbers but, for example,
    times, and nothing is missing.
    """
    found = []
    for series in _steps(paths).values():
        votes = Counter(step for step in series.values() if step > 0)
        if not votes:
            continue
        usual = min(votes, key=lambda step: (-votes[step], step))
        if 2 * votes[usual] >= votes.total():
            found += [at for at, step in series.items() if step > usual]
    return sorted(found)


def same_numbers(paths: Sequence[PurePath]) -> list[int]:
    """After which paths the number stays the same: img1.jpg, img1.png, or img1.jpg, img01.jpg."""
    return sorted(
        at for series in _steps(paths).values() for at, step in series.items() if step == 0
    )


def _steps(paths: Sequence[PurePath]) -> dict[tuple[str, str, str], dict[int, int]]:
    """Per series: index of a path -> the next path's number minus its own."""
    series: dict[tuple[str, str, str], dict[int, int]] = defaultdict(dict)
    numbers = [_numbered(path) for path in paths]
    for at, (this, following) in enumerate(pairwise(numbers)):
        if this is not None and following is not None and this[0] == following[0]:
            series[this[0]][at] = following[1] - this[1]
    return series


def _numbered(path: PurePath) -> tuple[tuple[str, str, str], int] | None:
    """Folder and text around the last number of a file name, and that number."""
    found = _LAST_NUMBER.fullmatch(path.stem)
    if found is None:
        return None
    before, digits, after = found.groups()
    return (str(path.parent), before, after), int(digits)
