"""The selectors that ship: which there are, without loading PyTorch."""

from __future__ import annotations

from pathlib import Path

from amusic_gym.settings import STATISTICS, SICSettings

PRETRAINED = Path(__file__).parent / "pretrained"

SHIPPED = ("evidence", "belief")
"""Statistics that a selector ships for, each a run folder in `PRETRAINED`."""


def shipped(statistic: str = SICSettings.statistic) -> Path:
    """Run folder of the selector that ships for a statistic.

    Raises:
        ValueError: for a statistic that none ships for.
    """
    if statistic not in SHIPPED:
        known = " and ".join(SHIPPED)
        about = "" if statistic in STATISTICS else ", which is no statistic"
        raise ValueError(
            f"no selector ships for the statistic {statistic!r}{about}; one does for {known}."
            " Train one, or take one of these"
        )
    return PRETRAINED / statistic
