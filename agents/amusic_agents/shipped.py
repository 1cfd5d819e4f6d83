"""The selectors that ship: which there are, without loading PyTorch."""

from pathlib import Path

from amusic_gym.estimation.settings import STATISTICS, SICSettings

PRETRAINED = Path(__file__).parent / "pretrained"
SHIPPED = ("evidence", "belief")  # statistics that a selector ships for: folders of `PRETRAINED`
IDLING = ("evidence",)  # statistics that one ships for, besides, which may run nothing on a frame


def shipped(statistic: str = SICSettings.statistic, *, allow_idle: bool = False) -> Path:
    """Run folder of the selector that ships for a statistic, or of the one that may idle.

    Raises:
        ValueError: for a statistic that none ships for.
    """
    ships, what = (IDLING, "selector that may idle") if allow_idle else (SHIPPED, "selector")
    if statistic not in ships:
        known = " and ".join(ships)
        about = "" if statistic in STATISTICS else ", which is no statistic"
        raise ValueError(
            f"no {what} ships for the statistic {statistic!r}{about}; one does for {known}."
            " Train one, or take one of these"
        )
    return PRETRAINED / (f"{statistic}-idle" if allow_idle else statistic)
