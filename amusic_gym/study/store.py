"""Finished cells on disk: one small JSON file each, whole or not there at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import amusic_gym
from amusic_gym.comparison_files import file_digest, read_checked
from amusic_gym.extraction.code import key_of
from amusic_gym.storage import write_whole
from amusic_gym.study.cells import MEASURED, Measures

FORMAT_VERSION = 3

FOLDER = "cells"

_SHOWING = ("extraction", "pictures", "plots", "study", "techniques")
_SHOWN = ("importers.py", "navigation.py", "report.py", "video.py", "window.py")
_MEASURING = "study/cells.py"


def code() -> str:
    """Digest of the package's code and data that a cell's numbers depend on.

    Left out is what works on images, and what only shows results: a better figure must not cost
    the cells of a long study.
    """
    package = Path(amusic_gym.__file__).parent
    digests = {}
    for file in (file for kind in ("*.py", "*.json") for file in package.rglob(kind)):
        name = file.relative_to(package).as_posix()
        if name == _MEASURING or not (name.partition("/")[0] in _SHOWING or name in _SHOWN):
            digests[name] = file_digest(file)
    return key_of(**digests)


def stem(key: Mapping[str, Any]) -> str:
    """Name of the file that keeps the cell of a key, without its end."""
    return key_of(format=FORMAT_VERSION, **key)[:24]


def save(folder: Path, stem: str, measures: Measures) -> Path:
    """Keep the numbers of a finished cell."""
    body = {"cell": stem, "measures": measures}
    text = json.dumps({"checksum": key_of(**body), **body}, allow_nan=False)
    return write_whole(folder / f"{stem}.json", text.encode())


def load(folder: Path, stem: str) -> Measures | None:
    """The numbers of a finished cell; None where there are none.

    Raises:
        ValueError: when the file is damaged.
    """
    path = folder / f"{stem}.json"
    body = read_checked(path, lambda body: key_of(**body))
    if body is None:
        return None
    measures = body.get("measures")
    numbers: Measures = measures if isinstance(measures, dict) else {}
    plain = all(isinstance(value, int | float | None) for value in numbers.values())
    if body.get("cell") != stem or set(numbers) != set(MEASURED) or not plain:
        raise ValueError(f"{path} is damaged (it holds other numbers than a cell's); delete it")
    return numbers
