"""The paper's methods and what it says they reach (A-MuSIC, tables II and III)."""

import json
from functools import cache
from importlib.resources import files
from typing import Any

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
    text = files("amusic_gym.evaluation.reproduction").joinpath("paper.json").read_text("utf-8")
    table: dict[str, Any] = json.loads(text)
    return table
