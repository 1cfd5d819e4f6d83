"""The paper's methods and what it says they reach (A-MuSIC, tables II and III)."""

from functools import cache
from pathlib import Path
from typing import Any

from amusic_gym.utils.reading import read_json

TECHNIQUES = ("HOG", "CALC", "CoHOG", "NetVLAD")

METHODS = {
    **{name: f"raw:{name}" for name in TECHNIQUES},
    **{f"{name}+SIC": f"single:{name}" for name in TECHNIQUES},
    "MuSIC": "music",
    "A-MuSIC": "amusic",
}
"""Method as table II names it → policy."""

TITLES = {
    "nordland_winter": "Winter",
    "nordland_fall": "Fall",
    "berlin": "Berlin",
    "night_right": "Night-Right",
    "17_places": "17 Places",
    "st_lucia": "St. Lucia",
}
"""Data set → its name in the paper's tables, in the order of table II."""


@cache
def figures() -> dict[str, Any]:
    """``auc`` and ``milliseconds`` [data set][method], ``adaptation`` [data set] (table III)."""
    table: dict[str, Any] = read_json(Path(__file__).with_suffix(".json"), "install it again")
    return table
