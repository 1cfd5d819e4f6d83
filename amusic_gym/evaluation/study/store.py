"""Finished cells on disk: one small JSON file each, whole or not there at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from amusic_gym.evaluation.comparison_files import read_checked
from amusic_gym.evaluation.study.cells import MEASURED, Measures
from amusic_gym.extraction.code import key_of
from amusic_gym.utils.imports import PACKAGE, digest_of, source_files
from amusic_gym.utils.storage import write_whole

FORMAT_VERSION = 3

FOLDER = "cells"

_SHOWING = ("live", "envs.pictures", "evaluation.plots", "evaluation.report", "envs.window")
"""Modules and subpackages that only show results: a better figure costs no cell of a study."""


def sources(package: Path = PACKAGE) -> tuple[Path, ...]:
    """The package's code that a cell's numbers depend on, and the data beside it."""
    without = [f"{package.name}.{name}" for name in _SHOWING]
    files = source_files(package / "evaluation" / "study" / "cells.py", package=package, without=without)
    data = {at for folder in {file.parent for file in files} for at in folder.glob("*.json")}
    return (*files, *sorted(data))


def code(package: Path = PACKAGE) -> str:
    """Digest of :func:`sources`."""
    return digest_of(*sources(package))


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
