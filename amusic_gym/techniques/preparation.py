"""Preparation of an image for a network."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.protocol import Image
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import suggest

CALC_SIZE = (160, 120)  # width and height of the images that CALC's network takes

INTERPOLATIONS = {
    "cubic": cv2.INTER_CUBIC,
    "linear": cv2.INTER_LINEAR,
    "area": cv2.INTER_AREA,
}

WIDEST = 8192  # largest side of a network's input: a damaged file must not fill the memory
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Preparation:
    """How NetVLAD's input is made from an image; it belongs to the weights.

    Raises:
        ValueError: for values that make no image.
    """

    width: int = 160  # pixels of the network's input
    height: int = 120  # likewise
    mean: Triple = (123.675, 116.28, 103.53)  # of red, green and blue in 0–255; is subtracted
    deviation: Triple = (58.395, 57.12, 57.375)  # divides; both are ImageNet's
    interpolation: str = "area"  # one of `INTERPOLATIONS`

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            whole(name, getattr(self, name), 1, most=WIDEST)
        for name in ("mean", "deviation"):
            values = getattr(self, name)
            if len(values) != 3 or not all(math.isfinite(value) for value in values):
                raise ValueError(f"{name} is {values!r}; give red, green and blue")
        if min(self.deviation) <= 0:
            raise ValueError(f"deviation is {self.deviation!r}; give numbers above 0")
        if self.interpolation not in INTERPOLATIONS:
            raise ValueError(suggest("interpolation", self.interpolation, INTERPOLATIONS))

    def apply(self, image: Image) -> NDArray[np.float32]:
        """(3, height, width) red, green, blue, standardised."""
        check_image(image)
        size = (self.width, self.height)
        small = cv2.resize(image, size, interpolation=INTERPOLATIONS[self.interpolation])
        values = small[:, :, ::-1].astype(np.float32)  # BGR -> RGB
        values -= np.array(self.mean, np.float32)
        values /= np.array(self.deviation, np.float32)
        return np.ascontiguousarray(values.transpose(2, 0, 1))  # (H, W, 3) -> (3, H, W)


def prepare_calc(image: Image) -> NDArray[np.float32]:
    """(1, 120, 160) grey, 0 to 1, its brightness equalised before it is made smaller.

    As VPR-Bench does it (Zaffar et al. 2021, its module for CALC).
    """
    check_image(image)
    luminance = cv2.cvtColor(image, cv2.COLOR_BGR2YUV)
    luminance[:, :, 0] = cv2.equalizeHist(luminance[:, :, 0])
    grey = cv2.cvtColor(cv2.cvtColor(luminance, cv2.COLOR_YUV2BGR), cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, CALC_SIZE, interpolation=cv2.INTER_CUBIC)
    return small.astype(np.float32)[np.newaxis] / np.float32(255)


def check_image(image: Image) -> None:
    """Refuse an array that is no image: of another shape or type than (height, width, 3) uint8."""
    shape, dtype = np.shape(image), getattr(image, "dtype", type(image).__name__)
    if len(shape) != 3 or shape[2] != 3 or 0 in shape or dtype != np.uint8:
        raise ValueError(
            f"the image has shape {shape} and type {dtype}; give (height, width, 3) uint8, "
            "blue-green-red, as amusic_gym.routes.images.read_image does"
        )
