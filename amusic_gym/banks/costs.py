"""What a run of a technique costs: checked seconds, and the models to reckon with."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks.scores import read_only
from amusic_gym.utils.names import suggest

COST_MODELS = ("measured", "paper", "runs")
"""``measured``: the bank's seconds; ``paper``: the paper's averages; ``runs``: 1 for each run."""

PAPER_SECONDS = {"HOG": 0.045, "CALC": 0.165, "CoHOG": 0.707, "NetVLAD": 0.722}
"""Seconds per frame, averaged over the paper's data sets (A-MuSIC, last column of the table)."""

SHORTEST, LONGEST = 1e-12, 1e12
"""Seconds of one run: sums and ratios of these are exact enough, and never infinite."""


def check_seconds(seconds: ArrayLike, techniques: Sequence[str]) -> NDArray[np.float64]:
    """(T,) float64 seconds per run, refused unless there is a positive number per technique."""
    try:
        array = np.array(seconds, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"seconds are {seconds!r}; give one number per technique") from None
    if array.shape != (len(techniques),):
        raise ValueError(
            f"seconds have shape {array.shape}; give one number for each of the "
            f"{len(techniques)} techniques"
        )
    for name, value in zip(techniques, array, strict=True):
        if not SHORTEST <= value <= LONGEST:
            raise ValueError(
                f"seconds of technique {name!r} are {value}; give a finite number above 0, from "
                f"{SHORTEST:g} to {LONGEST:g}"
            )
    return read_only(array)


def declared_seconds(seconds: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
    """Seconds that a user gives for techniques, by name; refuses what is unknown or not above 0."""
    for name in seconds:
        if name not in names:
            raise ValueError("seconds: " + suggest("technique", name, names))
    checked = check_seconds(list(seconds.values()), list(seconds))
    return dict(zip(seconds, checked.tolist(), strict=True))


def paper_seconds(techniques: Sequence[str]) -> NDArray[np.float64]:
    """(T,) seconds of the paper's techniques; refuses one that it does not time."""
    by_name = {name.casefold(): seconds for name, seconds in PAPER_SECONDS.items()}
    for name in techniques:
        if name.casefold() not in by_name:
            raise ValueError(
                f"the paper gives no time for technique {name!r}, only for "
                f"{', '.join(PAPER_SECONDS)}; use costs 'measured' or 'runs'"
            )
    return read_only(np.array([by_name[name.casefold()] for name in techniques]))
