"""Finished results on disk: a JSON file each, named by a digest of all that may change it."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym.banks import bank_files
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import ESTIMATORS
from amusic_gym.extraction.code import key_of
from amusic_gym.utils.imports import PACKAGE, digest_of, source_files
from amusic_gym.utils.reading import read_json
from amusic_gym.utils.storage import write_whole

FORMAT_VERSION = 4
"""Of the files. Those of another version have other names."""


def sources(entry: Path, *packages: Path) -> tuple[Path, ...]:
    """A source file, those that it depends on by its imports, and the JSON data beside them.

    The estimators, which are imported by name, are among them. ``packages`` are folders of the
    packages whose files count, in the order of their dependence; the last is this one, or a copy.
    """
    modules = {where.partition(":")[0] for where in ESTIMATORS.values()}
    root = packages[-1].parent
    files = {entry, *(root.joinpath(*name.split(".")).with_suffix(".py") for name in modules)}
    for package in packages:
        files |= {each for file in files for each in source_files(file, package=package)}
    files |= {data for folder in {file.parent for file in files} for data in folder.glob("*.json")}
    return tuple(sorted(files))


def code_digest(entry: Path, *packages: Path) -> str:
    """Digest of a source file and of what it depends on in some packages and in this one."""
    return digest_of(*sources(entry, *packages, PACKAGE))


def bank_identity(bank: ScoreBank) -> str:
    """Digest of all that a policy can see of a bank: scores, techniques, seconds and truth.

    Of a bank on disk its ``bank.json`` stands for the scores, by the checksums that it holds.
    """
    digest = hashlib.sha256(json.dumps([bank.techniques, bank.seconds.tolist()]).encode())
    if bank.path is not None:
        digest.update(digest_of(bank.path / bank_files.MANIFEST).encode())
    else:
        truth = (bank.truth.indptr, bank.truth.places, np.array([bank.tolerance, *bank.shape]))
        for array in (bank.scores, *truth):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def stem_of(key: Mapping[str, Any]) -> str:
    """Name of a file, without its end, by all that may change what it holds."""
    return key_of(format=FORMAT_VERSION, **key)[:24]


def save(folder: Path, stem: str, content: Mapping[str, Any]) -> Path:
    """Keep a result, whole or not at all."""
    body = {"stem": stem, **content}
    text = json.dumps({"checksum": key_of(**body), **body}, allow_nan=False)
    return write_whole(folder / f"{stem}.json", text.encode())


def load(folder: Path, stem: str) -> dict[str, Any] | None:
    """A finished result; None where there is none.

    Raises:
        ValueError: when the file is damaged, or another one that was renamed.
    """
    path = folder / f"{stem}.json"
    try:
        body: dict[str, Any] = read_json(path, "delete it")
    except FileNotFoundError:
        return None
    if body.pop("checksum", None) != key_of(**body) or body.pop("stem", None) != stem:
        raise damaged(folder, stem, "its checksum differs")
    return body


def damaged(folder: Path, stem: str, reason: object) -> ValueError:
    """What to raise where a file holds something else than it should."""
    return ValueError(f"{folder / stem}.json is damaged ({reason}); delete it")
