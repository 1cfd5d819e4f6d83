"""Names and scores of techniques, checked."""

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Number = TypeVar("_Number", bound=np.generic)


def check_names(techniques: Sequence[str], count: int | None = None) -> tuple[str, ...]:
    """``techniques`` as a tuple of different, usable names, ``count`` of them; None: at least one.

    Raises:
        ValueError: for another number of names, or a name that is empty, repeated, or ambiguous
            in a command's arguments.
    """
    if isinstance(techniques, str):
        raise ValueError(f"techniques is the text {techniques!r}; give a list of names")
    names = tuple(techniques)
    if not names:
        raise ValueError("no technique; give at least one")
    if count is not None and len(names) != count:
        raise ValueError(f"{len(names)} technique names for {count} score matrices")
    for name in names:
        if not isinstance(name, str) or not name.strip():
            raise ValueError(f"technique name {name!r} is empty or not text; give it a name")
        if name != name.strip() or not name.isprintable() or set(name) & set("+,:=/\\"):
            raise ValueError(
                f"technique name {name!r} holds one of + , : = / \\, a control character or "
                "outer spaces, which commands and file names use; rename it"
            )
        if names.count(name) > 1:
            raise ValueError(f"technique {name!r} is named twice; give each a name of its own")
    return names


def check_rows(technique: str, rows: NDArray[np.float32], first: int = 0) -> None:
    """Refuse score rows (n, R), of the frames from ``first`` on, with NaN or +∞."""
    for frame, row in enumerate(rows, first):
        if not (row < np.inf).all():
            place = int(np.argmin(row < np.inf))
            raise ValueError(
                f"score of technique {technique!r} at frame {frame}, place {place} is "
                f"{row[place]} (as float32); every score must be finite, or −∞ for a "
                "place that is no candidate: compute that row again"
            )


def floored(rows: NDArray[Any]) -> NDArray[Any]:
    """Rows (..., R) in which places that are no candidates have the row's lowest score; 0 if all.

    For what ranks or draws rows and knows of no −∞; the same array where there is none.
    """
    masked = np.isneginf(rows)
    if not masked.any():
        return rows
    lowest = np.where(masked, np.inf, rows).min(axis=-1, keepdims=True)
    return np.where(masked, np.where(np.isposinf(lowest), 0, lowest), rows).astype(rows.dtype)


def as_scores(scores: ArrayLike) -> NDArray[np.float32]:
    """Scores (T, Q, R) as read-only float32; a memory map of such is taken as it is.

    Raises:
        ValueError: for another number of axes, none of one, or what is no real number.
    """
    array = np.asarray(scores)
    if array.ndim != 3 or array.size == 0:
        raise ValueError(
            f"scores have shape {array.shape}; give [technique, query, reference] with at least "
            "one of each"
        )
    if array.dtype.kind not in "fiub":
        raise ValueError(f"scores have dtype {array.dtype}; give real numbers")
    mapped = isinstance(scores, np.memmap) and scores.mode == "r"
    if mapped and array.dtype == np.float32 and array.flags.c_contiguous:
        return array
    return read_only(as_float32(array))


def as_float32(scores: NDArray[Any]) -> NDArray[np.float32]:
    """A copy in float32; what is too large for it becomes NaN, not ±∞, and is refused as that."""
    with np.errstate(over="ignore"):
        kept: NDArray[np.float32] = np.array(scores, dtype=np.float32, order="C")
    if scores.dtype != np.float32:
        kept[np.isneginf(kept) & (scores > -np.inf)] = np.nan
    return kept


def read_only(array: NDArray[_Number]) -> NDArray[_Number]:
    """The array, which nobody can change from now on."""
    array.flags.writeable = False
    return array
