"""Corridor, a real recording, and the numbers that four techniques must give on it.

The recording is not part of the project: the variable AMUSIC_DATA names a folder that holds
`corridor/scores/NAME.npy` (Q, R), `corridor/ground_truth.npy` (Q, R) and
`corridor/techniques.json`.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

TECHNIQUES = ("HOG", "CALC", "CoHOG", "NetVLAD")
COLUMNS = (
    *("accuracy", "auc", "auc_vprbench", "auc_paper"),
    *("ptr", "compute", "runs", "reselections"),
)

# (policy, statistic) -> the columns above, to four decimals; None where nothing is claimed.
# K = 50, F = 1000, gamma = 1, M = 10, E = 0.7, alpha = 0.05.
_ROWS: dict[tuple[str, str], tuple[float | None, ...]] = {
    ("raw:HOG", "mean"): (0.4775, 0.3328, 0.6971, 0.6909, 0.25, None, 111, 0),
    ("raw:CALC", "mean"): (0.3243, 0.2554, 0.7876, 0.6270, 0.25, None, 111, 0),
    ("raw:CoHOG", "mean"): (0.6216, 0.4273, 0.6874, 0.7847, 0.25, None, 111, 0),
    ("raw:NetVLAD", "mean"): (0.6757, 0.5553, 0.8219, 0.8447, 0.25, None, 111, 0),
    ("single:HOG", "mean"): (0.9009, 0.7340, 0.8147, 0.8669, 0.25, None, 111, 0),
    ("single:CALC", "mean"): (0.3063, 0.0996, 0.3250, 0.5113, 0.25, None, 111, 0),
    ("single:CoHOG", "mean"): (0.9640, 0.9266, 0.9612, 0.9786, 0.25, None, 111, 0),
    ("single:NetVLAD", "mean"): (0.9910, 0.9755, 0.9844, 0.9936, 0.25, None, 111, 0),
    ("music", "mean"): (0.9099, 0.7758, 0.8526, 0.9029, 1.0, 1.0, 444, 0),
    ("amusic", "mean"): (0.9910, 0.9836, 0.9926, 0.9939, 0.4527, 0.7971, 201, 2),
    ("single:HOG", "evidence"): (0.9459, 0.9459, 1.0, 0.9128, 0.25, None, 111, 0),
    ("single:CALC", "evidence"): (0.8468, 0.8288, 0.9787, 0.9320, 0.25, None, 111, 0),
    ("single:CoHOG", "evidence"): (1.0, 1.0, 1.0, 1.0, 0.25, None, 111, 0),
    ("single:NetVLAD", "evidence"): (1.0, 1.0, 1.0, 1.0, 0.25, None, 111, 0),
    ("music", "evidence"): (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 444, 0),
    ("amusic:evidence", "evidence"): (1.0, 1.0, 1.0, 1.0, 0.5878, 0.5493, 261, 4),
}

EXPECTED: dict[tuple[str, str], dict[str, float]] = {
    key: {name: value for name, value in zip(COLUMNS, row, strict=True) if value is not None}
    for key, row in _ROWS.items()
}


class Corridor(NamedTuple):
    """The recording as plain arrays."""

    scores: NDArray[np.float32]  # (T, Q, R)
    techniques: tuple[str, ...]
    seconds: NDArray[np.float64]  # (T,) one run: encode an image, match it with every place
    ground_truth: NDArray[np.bool_]  # (Q, R)


def data_folder(recording: str = "corridor") -> Path:
    """The folder of real recordings; skips the test where none is named."""
    named = os.environ.get("AMUSIC_DATA")
    if not named:
        pytest.skip(f"needs a real recording: set AMUSIC_DATA to a folder that holds {recording}/")
    return Path(named)


def load(techniques: tuple[str, ...] = TECHNIQUES) -> Corridor:
    """Corridor's scores of some techniques; skips the test where AMUSIC_DATA is not set."""
    folder = data_folder() / "corridor"
    scores = np.stack([np.load(folder / "scores" / f"{name}.npy") for name in techniques])
    times: dict[str, Any] = json.loads((folder / "techniques.json").read_text(encoding="utf-8"))
    references = scores.shape[2]
    seconds = [times[n]["encode_s"] + references * times[n]["match_s"] for n in techniques]
    truth = np.load(folder / "ground_truth.npy")
    return Corridor(scores, techniques, np.array(seconds), truth)


def differences(policy: str, statistic: str, measured: dict[str, Any]) -> list[str]:
    """What of a results row does not match the table to its four decimals; [] when all does.

    Columns that `measured` lacks are not compared, except accuracy and the three areas.
    """
    found = []
    for name, expected in EXPECTED[policy, statistic].items():
        if name not in measured and name not in COLUMNS[:4]:
            continue
        value = float(measured[name])
        if f"{value:.4f}" != f"{expected:.4f}":
            found.append(f"{policy} ({statistic}): {name} is {value:.6f}, expected {expected}")
    return found
