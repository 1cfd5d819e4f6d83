"""Finished rows of a comparison on disk: one JSON file each, whole or not there at all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym.banks import bank_files
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.policies.trace import Trace
from amusic_gym.utils.storage import read_json, write_whole

FORMAT_VERSION = 3
"""Of a row's file: 2 has ``similarity``, 3 ``carry``. Others are written again."""

Key = Mapping[str, Any]


def bank_identity(bank: ScoreBank) -> str:
    """Digest of all that a policy can see of a bank: scores, techniques, seconds and truth.

    Of a bank on disk its ``bank.json`` stands for the scores, by the checksums that it holds.
    """
    digest = hashlib.sha256()
    if bank.path is not None:
        digest.update(file_digest(bank.path / bank_files.MANIFEST).encode())
    else:
        truth = (bank.truth.indptr, bank.truth.places, np.array([bank.tolerance, *bank.shape]))
        for array in (bank.scores, *truth):
            digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(json.dumps([bank.techniques, bank.seconds.tolist()]).encode())
    return digest.hexdigest()


def file_digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def code_digest(package: Path) -> str:
    """Digest of a package's source and data: what its results depend on besides their input."""
    digest = hashlib.sha256()
    files = [file for kind in ("*.py", "*.json") for file in package.rglob(kind)]
    for file in sorted(files):
        digest.update(f"{file.relative_to(package).as_posix()} {file_digest(file)}\n".encode())
    return digest.hexdigest()


def row_path(folder: Path, key: Key) -> Path:
    """Where the row of a key is kept: it changes with anything that may change the row."""
    return folder / f"{_digest(key)[:20]}.json"


def save_row(folder: Path, key: Key, trace: Trace, row: Mapping[str, Any]) -> Path:
    """Keep a finished row and all that is needed to draw it."""
    body = {"format": FORMAT_VERSION, "key": dict(key), "row": dict(row), "trace": _plain(trace)}
    text = json.dumps({"checksum": _digest(body), **body}, allow_nan=False)
    return write_whole(row_path(folder, key), text.encode())


def load_row(folder: Path, key: Key, bank: ScoreBank) -> Trace | None:
    """The trace of a finished row; None where there is none, or one of another format.

    Raises:
        ValueError: when the file is damaged.
    """
    path = row_path(folder, key)
    body = read_checked(path, _digest)
    if body is None or body.get("format") != FORMAT_VERSION:
        return None
    try:
        trace = body["trace"]
        estimates = [np.nan if value is None else value for value in trace.pop("p_correct")]
        return Trace.join(
            bank,
            p_correct=estimates,
            policy=key["policy"],
            statistic=key["statistic"],
            carry=key["carry"],
            compute_weight=key["compute_weight"],
            **trace,
        )
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise ValueError(f"{path} is damaged ({error}); delete it") from None


def read_checked(path: Path, digest: Callable[[dict[str, Any]], str]) -> dict[str, Any] | None:
    """The JSON object of a file that holds its own checksum; None where there is no file.

    Raises:
        ValueError: when the file is damaged.
    """
    try:
        body: dict[str, Any] = read_json(path, "delete it")
    except FileNotFoundError:
        return None
    if body.pop("checksum", None) != digest(body):
        raise ValueError(f"{path} is damaged (its checksum differs); delete it")
    return body


def save_results(path: Path, rows: list[dict[str, Any]], mean: list[dict[str, Any]]) -> Path:
    """Write ``results.json``."""
    text = json.dumps({"rows": rows, "mean": mean}, indent=1, allow_nan=False)
    return write_whole(path, text.encode() + b"\n")


def _plain(trace: Trace) -> dict[str, Any]:
    """What the policy did, without what a bank says of it."""
    estimates = [None if np.isnan(value) else value for value in trace.p_correct.tolist()]
    return {
        "predictions": trace.predictions.tolist(),
        "confidence": trace.confidence.tolist(),
        "similarity": trace.similarity.tolist(),
        "p_correct": estimates,
        "chosen": trace.chosen.tolist(),
        "ran": trace.ran.astype(int).tolist(),
        "late_runs": trace.late_runs.tolist(),
        "selections": trace.selections.astype(int).tolist(),
    }


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
