"""AMOSNet and HybridNet: networks that learned to tell places apart (Chen et al. 2017)."""

import hashlib
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from amusic_gym.techniques.arguments import parsed
from amusic_gym.techniques.networks import load_layers
from amusic_gym.techniques.preparation import check_image
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique
from amusic_gym.techniques.weight_files import read_weights
from amusic_gym.utils.reading import read_array

SIZE = 227  # width and height of the input in pixels
MEAN = (121.50, 122.37, 121.26)  # mean blue, green and red of the authors' training images

CELLS = (
    ((0, 13),),
    ((0, 6), (7, 12)),
    ((0, 4), (5, 8), (9, 12)),
    ((0, 3), (4, 6), (7, 9), (10, 12)),
)
"""First and end of the rows, and of the columns, of each level's cells.

As VPR-Bench cuts them: the ends are left out, so that rows and columns between cells, and the last
one, belong to the first level only.
"""

SCALE = 65536.0  # distance at which the similarity is 0


class PlaceNetwork(nn.Module):
    """Caffe's layers conv1 to conv5, shared by AMOSNet and HybridNet."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 96, 11, stride=4)
        self.conv2 = nn.Conv2d(96, 256, 5, padding=2, groups=2)
        self.conv3 = nn.Conv2d(256, 384, 3, padding=1)
        self.conv4 = nn.Conv2d(384, 384, 3, padding=1, groups=2)
        self.conv5 = nn.Conv2d(384, 256, 3, padding=1, groups=2)
        self.pool = nn.MaxPool2d(3, stride=2)
        self.norm = nn.LocalResponseNorm(5, alpha=1e-4, beta=0.75, k=1.0)

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, 227, 227) blue, green, red, less the mean -> (B, 256, 13, 13), none below 0."""
        x = self.norm(self.pool(torch.relu(self.conv1(images))))
        x = self.norm(self.pool(torch.relu(self.conv2(x))))
        return torch.relu(self.conv5(torch.relu(self.conv4(torch.relu(self.conv3(x))))))


def spatial_pyramid(features: Tensor) -> Tensor:
    """Maxima over 30 cells: (C, 13, 13) -> (C, 30), coarse to fine, row by row."""
    maxima = [
        features[:, top:bottom, left:right].amax((1, 2))
        for level in CELLS
        for top, bottom in level
        for left, right in level
    ]
    return torch.stack(maxima, dim=1)


class AMOSNet(Technique):
    """Maxima of conv5 over a spatial pyramid; 256 · 30 = 7,680 values, 1 − L1 / 65,536.

    Args:
        weights: ``AmosNet.caffemodel``, or the layers conv1 to conv5 in another container that
            :func:`~amusic_gym.techniques.weight_files.read_weights` knows. None ship.
        argument: the authors' mean image, ``mean=FILE.npy`` (3, H, W) blue, green, red, brought to
            227×227 as VPR-Bench does; nothing: its mean colour, as the authors do.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: without weights, or for a file that is damaged or has other layers.
    """

    name = "AMOSNet"

    def __init__(self, argument: str = "", weights: str | Path | None = None) -> None:
        if weights is None:
            raise ValueError(
                f"{self.name} needs its authors' weights, which do not ship: "
                f"--weights {self.name.lower()}={self.name}.caffemodel"
            )
        file = read_weights(weights)
        part = file.part(self.name, "conv1.weight")
        self._network = load_layers(PlaceNetwork, partial(part.layer, self.name))
        self._digest = file.digest
        self._mean, self._mean_digest = _mean(argument)

    def parameters(self) -> Parameters:
        """The digests of the weights and of the mean image, and the input's size."""
        return {"weights": self._digest, "mean": self._mean_digest, "size": SIZE}

    def describe(self, image: Image) -> Descriptor:
        """(7680,), channel by channel; none below 0."""
        check_image(image)
        small = cv2.resize(image, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
        values = torch.from_numpy(small.astype(np.float32) - self._mean)
        with torch.inference_mode():
            features = self._network(values.permute(2, 0, 1)[None])[0]
            descriptor: Descriptor = spatial_pyramid(features).flatten().numpy()
        return descriptor

    def match(self, query: Descriptor, references: Descriptor) -> NDArray[np.float32]:
        """(B,) 1 less the sum of absolute differences over 65,536."""
        distances = np.abs(references - query).sum(axis=1, dtype=np.float64)
        scores: NDArray[np.float32] = (1.0 - distances / SCALE).astype(np.float32)
        return scores


class HybridNet(AMOSNet):
    """As :class:`AMOSNet`, with the weights of a network that also learned objects and scenes."""

    name = "HybridNet"


def _mean(argument: str) -> tuple[NDArray[np.float32], str]:
    """The mean (1, 1, 3) or (227, 227, 3), and the digest of its file."""
    path = parsed(argument, mean="")["mean"]
    if not path:
        return np.array(MEAN, np.float32)[None, None], ""
    array: NDArray[Any] = read_array(path)
    if array.ndim != 3 or len(array) != 3 or 0 in array.shape or array.dtype.kind not in "fiu":
        raise ValueError(f"the mean image {path} has shape {array.shape}; give (3, H, W) numbers")
    values = np.ascontiguousarray(array.transpose(1, 2, 0), np.float32)
    if not np.isfinite(values).all():
        raise ValueError(f"the mean image {path} holds NaN or infinite numbers; download it again")
    resized = cv2.resize(values, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
    return np.asarray(resized, np.float32), hashlib.sha256(values.tobytes()).hexdigest()
