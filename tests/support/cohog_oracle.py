"""CoHOG once more, slowly and by other means: regions as such, and a plain loop to match them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

SMOOTH, SLOPE = np.array([1, 4, 6, 4, 1]), np.array([-1, -2, 0, 2, 1])

Floats = NDArray[np.float64]


def gradient(values: Floats, kernel: NDArray[np.int_]) -> Floats:
    """Correlation with a 5×5 kernel; the image is mirrored around its outermost pixels."""
    padded = np.pad(values, 2, mode="reflect")
    height, width = values.shape
    shifted = (
        kernel[i, j] * padded[i : i + height, j : j + width] for i in range(5) for j in range(5)
    )
    return np.asarray(sum(shifted))


def cells(grey: NDArray[np.uint8]) -> Floats:
    """(32, 32, 8) histograms: row, column, bin."""
    square = cv2.resize(grey, (512, 512)).astype(float)
    evened = np.sqrt(square / max(1, square.max())) * 255
    across = gradient(evened, np.outer(SMOOTH, SLOPE))
    down = gradient(evened, np.outer(SLOPE, SMOOTH))
    turn = np.degrees(np.arctan2(down, across)) % 360 / 45
    strength = np.abs(0.5 * across + 0.5 * down)
    histograms = np.zeros((32, 32, 8))
    for row in range(32):
        for column in range(32):
            block = np.s_[16 * row : 16 * row + 16, 16 * column : 16 * column + 16]
            for direction in range(8):
                apart = np.abs(turn[block] - direction)
                near = np.maximum(0, 1 - np.minimum(apart, 8 - apart))
                histograms[row, column, direction] = np.sum(near * strength[block])
    return histograms


def regions(histograms: NDArray[np.floating]) -> Floats:
    """(32, 32, 8) -> (961, 32), each of length 1, or 0 where there is nothing."""
    found = np.concatenate(
        [histograms[i : i + 31, j : j + 31] for i in (0, 1) for j in (0, 1)], axis=2
    ).reshape(961, 32)
    lengths = np.linalg.norm(found, axis=1, keepdims=True)
    return np.divide(found, lengths, out=np.zeros_like(found), where=lengths > 0)


def entropy(grey: NDArray[np.uint8]) -> Floats:
    """Entropy in bits of the grey values in a disk of radius 5, as far as it is in the image."""
    rows, columns = np.indices(grey.shape)
    result = np.empty(grey.shape)
    for y, x in np.ndindex(grey.shape):
        inside = (rows - y) ** 2 + (columns - x) ** 2 <= 25
        _, counts = np.unique(grey[inside], return_counts=True)
        shares = counts / counts.sum()
        result[y, x] = -np.sum(shares * np.log2(shares))
    return result


def region_entropy(entropy_of_100: Floats) -> Floats:
    """(961,) mean entropy of each 32×32 block of the 512×512 image, in bits."""
    large = cv2.resize(entropy_of_100, (512, 512))
    starts = [(16 * row, 16 * column) for row in range(31) for column in range(31)]
    return np.array([large[y : y + 32, x : x + 32].mean() for y, x in starts])


def score(query: Floats, interest: NDArray[np.bool_], reference: Floats) -> float:
    """Mean over the query's regions of interest of the best dot product with any region."""
    chosen = query[interest] if interest.any() else query
    return float((chosen @ reference.T).max(axis=1).mean())
