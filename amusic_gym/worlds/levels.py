"""Halved copies of a texture, so that far things neither flicker nor alias."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

LEVELS = 7
"""Halved copies of a texture, at most."""

Levels = tuple[NDArray[np.uint8], NDArray[np.int64]]
"""Pixels of all levels, flat, and (start, width, height) of each."""


def pyramid(texture: NDArray[np.uint8]) -> Levels:
    """All halved copies of a texture in one flat array, and where each begins.

    Args:
        texture: (H, W, 5) uint8: blue, green, red, alpha, glow; colours *not* yet times alpha.
    """
    alpha = texture[..., 3:4]
    colours = cv2.multiply(texture[..., :3], cv2.merge([alpha] * 3), scale=1 / 255)
    level = cv2.merge([*cv2.split(colours), texture[..., 3]])
    glow = cv2.multiply(texture[..., 4], texture[..., 3], scale=1 / 255)
    parts, table, start = [], [], 0
    for _ in range(LEVELS):
        height, width = glow.shape
        # Order in memory: blue, green, red, alpha, glow.
        parts.append(np.dstack([level, glow]).reshape(-1))
        table.append((start, width, height))
        start += parts[-1].size
        if min(height, width) < 4:
            break
        half = (width // 2, height // 2)
        level = cv2.resize(level, half, interpolation=cv2.INTER_AREA)
        glow = cv2.resize(glow, half, interpolation=cv2.INTER_AREA)
    return np.concatenate(parts), np.array(table, np.int64)
