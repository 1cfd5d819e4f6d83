"""Images of real recordings, for tests that compare with numbers from elsewhere."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from corridor import data_folder
from numpy.typing import NDArray

from amusic_gym.techniques import Technique


def read_folder(folder: Path) -> list[NDArray[np.uint8]]:
    """All images of a folder, by name; (H, W, 3) each, blue-green-red."""
    images = [cv2.imread(str(path), cv2.IMREAD_COLOR) for path in sorted(folder.iterdir())]
    assert images, f"{folder} is empty"
    return [np.asarray(image, np.uint8) for image in images]


ROUTES = {
    "corridor": ("corridor/reference", "corridor/query"),
    "gardens_day": ("gardens_point/day_left", "gardens_point/day_right"),
    "gardens_night": ("gardens_point/day_left", "gardens_point/night_right"),
}
"""Recording -> folders of its map and its run below `AMUSIC_DATA`."""


def accuracy(technique: Technique, recording: str, tolerance: int = 2) -> float:
    """Share of frames whose most similar place is a true one; skips the test without the images.

    Args:
        technique: what describes and matches.
        recording: of `ROUTES`.
        tolerance: places to either side that count, where the recording has no list of its own.
    """
    data = data_folder(recording)
    folders = [data / name for name in ROUTES[recording]]
    for folder in folders:
        if not folder.is_dir():
            pytest.skip(f"AMUSIC_DATA holds no {folder.relative_to(data)}/")
    places, run = (read_folder(folder) for folder in folders)
    references = np.stack([technique.describe(image) for image in places])
    best = [technique.match(technique.describe_query(i), references).argmax() for i in run]
    if recording == "corridor":
        truth = np.load(data / "corridor" / "ground_truth.npy")
        return float(truth[np.arange(len(run)), best].mean())
    return float((np.abs(np.array(best) - np.arange(len(run))) <= tolerance).mean())
