"""The loops over pixels of CoHOG's description, compiled."""

import numpy as np
from numpy.typing import NDArray

from amusic_gym.kernels.compiling import without_gil

RADIUS = 5  # of the disk around a pixel: all pixels at most so far away, centre to centre


@without_gil
def local_entropy(grey: NDArray[np.uint8], entropy: NDArray[np.float64]) -> None:
    """Fill ``entropy`` (H, W) float64, in bits, of the ``grey`` values (H, W) around each pixel.

    Those within ``RADIUS`` and inside the image.
    """
    height, width = grey.shape
    reach = np.zeros(RADIUS + 1, np.int64)  # how far the disk goes sideways, per row from its own
    for row in range(RADIUS + 1):
        reach[row] = int(np.sqrt(RADIUS**2 - row**2))
    terms = np.zeros((2 * RADIUS + 1) ** 2 + 1)  # n log2 n
    for n in range(2, terms.size):
        terms[n] = n * np.log2(n)
    counts = np.zeros(256, np.int64)
    for y in range(height):
        top, bottom = max(0, y - RADIUS), min(height, y + RADIUS + 1)
        for x in range(width):
            pixels = 0
            total = 0.0  # sum of n log2 n over the grey values seen so far, n times each
            for row in range(top, bottom):
                side = reach[abs(row - y)]
                for column in range(max(0, x - side), min(width, x + side + 1)):
                    value = grey[row, column]
                    total += terms[counts[value] + 1] - terms[counts[value]]
                    counts[value] += 1
                    pixels += 1
            entropy[y, x] = np.log2(pixels) - total / pixels
            for row in range(top, bottom):
                side = reach[abs(row - y)]
                for column in range(max(0, x - side), min(width, x + side + 1)):
                    counts[grey[row, column]] = 0


@without_gil
def add_directions(
    strength: NDArray[np.float32], turn: NDArray[np.float32], cells: NDArray[np.float64]
) -> None:
    """Share each pixel's strength (H, W) between the two bins that are next to its direction.

    ``turn`` (H, W) is in bins: 0 to B, both ends the same. ``cells`` (R, B, C), to add to: row of
    cells, bin, column; H / R pixels make a cell.
    """
    rows, bins, columns = cells.shape
    height, width = strength.shape[0] // rows, strength.shape[1] // columns
    for y in range(strength.shape[0]):
        cell_row = cells[y // height]
        for x in range(strength.shape[1]):
            lower = int(turn[y, x])
            upper_part = (turn[y, x] - lower) * strength[y, x]
            cell_row[lower % bins, x // width] += strength[y, x] - upper_part
            cell_row[(lower + 1) % bins, x // width] += upper_part
