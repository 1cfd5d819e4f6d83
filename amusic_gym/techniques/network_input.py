"""Input of a network that was trained with torchvision's transforms."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812 (its usual name)

from amusic_gym.techniques.preparation import WIDEST, Preparation, Triple, check_image
from amusic_gym.techniques.protocol import Image
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import suggest

RESIZE = ("stretch", "crop", "shorter")
INTERPOLATIONS = ("bilinear", "bicubic")


@dataclass(frozen=True)
class NetworkInput:
    """Size and colours of a network's input; refuses values that make none."""

    height: int  # pixels
    width: int  # pixels
    # ``"stretch"`` to height and width; ``"crop"`` the middle after the image covers them;
    # ``"shorter"``: the shorter side to the smaller of the two, proportions kept
    resize: str = "stretch"
    multiple: int = 1  # with ``"shorter"``: both sides are rounded to multiples of this
    # ``"bilinear"`` or ``"bicubic"``, smoothed where the image shrinks
    interpolation: str = "bilinear"
    mean: Triple = Preparation.mean  # of red, green and blue in 0–255; is subtracted
    deviation: Triple = Preparation.deviation  # of red, green and blue in 0–255; divides

    def __post_init__(self) -> None:
        Preparation(self.width, self.height, self.mean, self.deviation)  # checks these
        whole("multiple", self.multiple, 1, most=WIDEST)
        if self.resize not in RESIZE:
            raise ValueError(suggest("resize", self.resize, RESIZE))
        if self.interpolation not in INTERPOLATIONS:
            raise ValueError(suggest("interpolation", self.interpolation, INTERPOLATIONS))

    def apply(self, image: Image) -> Tensor:
        """(3, H, W) float32 red, green, blue, standardised; refuses what is no image."""
        check_image(image)
        colours = torch.from_numpy(np.ascontiguousarray(image[:, :, ::-1]))  # BGR -> RGB
        colours = colours.permute(2, 0, 1).float()[None]  # (1, 3, H, W)
        size = self._size(*image.shape[:2])
        colours = F.interpolate(colours, size, mode=self.interpolation, antialias=True)[0]
        if self.resize == "crop":
            top, left = (size[0] - self.height) // 2, (size[1] - self.width) // 2
            colours = colours[:, top : top + self.height, left : left + self.width]
        mean, deviation = (
            torch.tensor(values, dtype=torch.float32)[:, None, None]
            for values in (self.mean, self.deviation)
        )
        return (colours - mean) / deviation

    def _size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width that an image is brought to before anything is cut off."""
        if self.resize == "stretch":
            return self.height, self.width
        if self.resize == "crop":
            scale = max(self.height / height, self.width / width)
            return (
                max(self.height, round(height * scale)),
                max(self.width, round(width * scale)),
            )
        scale = min(self.height, self.width) / min(height, width)
        rows, columns = (
            max(1, round(n * scale / self.multiple)) * self.multiple for n in (height, width)
        )
        if max(rows, columns) > WIDEST:
            raise ValueError(
                f"an image of {width}×{height} pixels would become {columns}×{rows}, sides here "
                f"have {WIDEST} at most; cut its longer side"
            )
        return rows, columns
