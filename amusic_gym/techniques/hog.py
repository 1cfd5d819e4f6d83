"""HOG: histograms of gradient directions over the whole image (Dalal and Triggs, 2005)."""

import cv2
import numpy as np

from amusic_gym.techniques.preparation import check_image
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique

SIZE = 512  # width and height that images are brought to, in pixels
CELL = 16  # width and height of a cell, and of a block: blocks of one cell
STRIDE = 8  # pixels from one block to the next, so that blocks overlap
BINS = 9  # directions of 20° each; a gradient and its opposite are the same


class HOG(Technique):
    """HOG of the image at 512×512; descriptors of 63 · 63 · 9 = 35,721 values, cosine.

    The settings are those of VPR-Bench (Zaffar et al. 2021), which the A-MuSIC paper used: colour,
    bilinear to 512×512; per pixel the channel with the steepest gradient, no gamma; blocks of
    16×16 pixels every 8 pixels; L2-Hys with 0.2.
    """

    name = "HOG"

    def parameters(self) -> Parameters:
        """The sizes in pixels, and the directions."""
        return {"size": SIZE, "cell": CELL, "stride": STRIDE, "bins": BINS}

    def describe(self, image: Image) -> Descriptor:
        """(35721,) of length 1; all zeros for an image without any gradient."""
        check_image(image)
        square = cv2.resize(image, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
        window, cell, stride = (SIZE, SIZE), (CELL, CELL), (STRIDE, STRIDE)
        histograms = cv2.HOGDescriptor(window, cell, stride, cell, BINS)
        descriptor = np.asarray(histograms.compute(square), np.float32).ravel()
        length = np.linalg.norm(descriptor)
        return descriptor / length if length > 0 else descriptor
