"""CoHOG: regions of interest of the query, matched wherever they are (Zaffar et al., 2020).

An image is 32×32 cells of 16×16 pixels. A region is a square of 2×2 cells, one per cell that has
neighbours to the right and below: 31×31 = 961 regions that overlap. A region's 32 values are its
cells' histograms of 8 directions, scaled to length 1.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques._cohog_description import RADIUS, add_directions, local_entropy
from amusic_gym.techniques._cohog_kernel import BINS, SIDE, match_regions
from amusic_gym.techniques.preparation import check_image
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique

CELL = 16  # width and height of a cell in pixels
SIZE = SIDE * CELL  # width and height that images are brought to, in pixels: 512
ENTROPY_SIZE = 100  # width and height of the image in which entropy is measured, in pixels
INTEREST = 0.4  # least entropy of a region of interest, as a share of the 8 bits of a grey value
SHAPE = (SIDE, BINS + 1, SIDE)  # row of cells, bin (the ninth: a number per region), column


class CoHOG(Technique):
    """CoHOG on the grey image at 512×512; descriptors of 32·9·32 = 9,216 values.

    Score: the mean over the query's regions of interest of the greatest cosine with *any* region
    of the reference. The settings are those of VPR-Bench (Zaffar et al. 2021), which the A-MuSIC
    paper used.

    A descriptor holds the cells and not the regions, each of which repeats four cells. Its
    layout is ``SHAPE``; next to the bins of a cell stands what belongs to the region that begins
    with this cell: on the map the inverse of the region's length; in a query that, divided by the
    number of regions of interest, and 0 for the others.
    """

    name = "CoHOG"

    def parameters(self) -> Parameters:
        """The sizes in pixels, the directions, and what makes a region of interest."""
        return {
            "size": SIZE,
            "cell": CELL,
            "bins": BINS,
            "entropy_size": ENTROPY_SIZE,
            "entropy_radius": RADIUS,
            "interest": INTEREST,
        }

    def describe(self, image: Image) -> Descriptor:
        """(32, 9, 32): cells, and the inverse lengths of the regions."""
        cells = cells_of(_grey(image))
        return _joined(cells, inverse_lengths(cells))

    def describe_query(self, image: Image) -> Descriptor:
        """(32, 9, 32): cells, and the weights of the regions. Without any of interest all count."""
        grey = _grey(image)
        cells = cells_of(grey)
        interest = regions_of_interest(grey)
        if not interest.any():
            interest[:] = True
        weights = inverse_lengths(cells) * interest / np.count_nonzero(interest)
        return _joined(cells, weights)

    def match(self, query: Descriptor, references: Descriptor) -> NDArray[np.float32]:
        """Scores (B,) of a query (32, 9, 32) with references (B, 32, 9, 32), 0 to 1.

        A score has the same bits whatever other references it is computed with. Python's lock is
        free meanwhile, so several threads may match at once.

        Raises:
            ValueError: for descriptors of another shape.
        """
        if query.shape != SHAPE or references.shape[1:] != SHAPE:
            raise ValueError(
                f"CoHOG matches a query of shape {SHAPE} with references (B, *{SHAPE}), not "
                f"{query.shape} with {references.shape}; describe the images again"
            )
        scores = np.empty(len(references), np.float32)
        rows = np.ascontiguousarray(references, np.float32).reshape(len(references), query.size)
        # A copy of the query, which may be written to: Numba compiles the read-only case apart.
        match_regions(np.array(query, np.float32).reshape(-1), rows, scores)
        return scores


def cells_of(grey: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(32, 8, 32) histograms of gradient directions: row of cells, bin of 45°, column.

    A pixel counts by |gx + gy| / 2, as VPR-Bench has it: a gradient towards the upper right or
    the lower left counts nothing. It is shared linearly between the two bins whose directions,
    multiples of 45°, are next to its own.
    """
    square = cv2.resize(grey, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
    brightness = np.sqrt(np.arange(256) / max(1, int(square.max()))) * 255
    evened = cv2.LUT(square, brightness.astype(np.float32))
    across = cv2.Sobel(evened, cv2.CV_32F, 1, 0, ksize=5)
    down = cv2.Sobel(evened, cv2.CV_32F, 0, 1, ksize=5)
    turn = cv2.phase(across, down, angleInDegrees=True) / np.float32(360 / BINS)
    strength = np.abs(across + down) * np.float32(0.5)
    cells = np.zeros((SIDE, BINS, SIDE))
    add_directions(strength, turn, cells)
    return cells


def inverse_lengths(cells: NDArray[np.float64]) -> NDArray[np.float64]:
    """(31, 31) 1 / length of each region of 2×2 cells; 0 where there is no gradient at all."""
    lengths = np.sqrt(_over_regions(np.square(cells).sum(axis=1)))
    return np.divide(1, lengths, out=np.zeros_like(lengths), where=lengths > 0)


def regions_of_interest(grey: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(31, 31) whether the mean entropy over a region's pixels is at least 40 % of 8 bits."""
    small = cv2.resize(grey, (ENTROPY_SIZE, ENTROPY_SIZE), interpolation=cv2.INTER_LINEAR)
    entropy = np.empty(small.shape)
    local_entropy(small.astype(np.uint8, copy=False), entropy)
    large = cv2.resize(entropy, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
    per_cell = large.reshape(SIDE, CELL, SIDE, CELL).mean(axis=(1, 3))
    interesting: NDArray[np.bool_] = _over_regions(per_cell) / 4 / 8 >= INTEREST
    return interesting


def _over_regions(cells: NDArray[np.float64]) -> NDArray[np.float64]:
    """(32, 32) one number per cell -> (31, 31) its sum over each region of 2×2 cells."""
    pairs = cells[:, :-1] + cells[:, 1:]
    return pairs[:-1] + pairs[1:]


def _joined(cells: NDArray[np.float64], per_region: NDArray[np.float64]) -> Descriptor:
    """Cells (32, 8, 32) and a number per region (31, 31), as one descriptor."""
    descriptor = np.zeros(SHAPE, np.float32)
    descriptor[:, :BINS] = cells
    descriptor[:-1, BINS, :-1] = per_region
    return descriptor


def _grey(image: Image) -> NDArray[np.uint8]:
    check_image(image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
