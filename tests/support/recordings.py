"""Images of real recordings, for tests that compare with numbers from elsewhere."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray


def read_folder(folder: Path) -> list[NDArray[np.uint8]]:
    """All images of a folder, by name; (H, W, 3) each, blue-green-red."""
    images = [cv2.imread(str(path), cv2.IMREAD_COLOR) for path in sorted(folder.iterdir())]
    assert images, f"{folder} is empty"
    return [np.asarray(image, np.uint8) for image in images]
