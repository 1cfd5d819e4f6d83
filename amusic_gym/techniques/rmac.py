"""R-MAC: maxima of a feature map over regions, on any backbone (Tolias, Sicre and Jégou, 2016)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812 (its usual name)

from amusic_gym.techniques.arguments import parsed
from amusic_gym.techniques.backbones import load_backbone
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique
from amusic_gym.techniques.weight_files import read_weights
from amusic_gym.utils.checks import whole as at_least

LEVELS = 3  # sizes of regions
OVERLAP = 0.4  # share of a region that its neighbour along the longer side should have, too
SETTINGS = {"levels": LEVELS, "whole": False, "whitening": ""}  # behind a technique's name


def regions(height: int, width: int, levels: int = LEVELS) -> Iterator[tuple[int, int, int]]:
    """Square regions of a feature map: row, column and side, level by level.

    As in the authors' program: on the coarsest level so many along the longer side that
    neighbours overlap by about ``OVERLAP``; each level has one more along either side.
    """
    short, long = min(height, width), max(height, width)
    steps = np.arange(1, 7)
    overlaps = (short**2 - short * ((long - short) / steps)) / short**2
    more = int(np.abs(overlaps - OVERLAP).argmin()) + 1
    more_rows, more_columns = (more if n > short else 0 for n in (height, width))
    for level in range(1, levels + 1):
        side = 2 * short // (level + 1)
        if side == 0:  # a map of one row has no smaller regions
            continue
        for row in _starts(height, side, level + more_rows):
            for column in _starts(width, side, level + more_columns):
                yield row, column, side


def _starts(size: int, side: int, count: int) -> list[int]:
    """First rows or columns of ``count`` regions, from edge to edge."""
    return [k * (size - side) // max(count - 1, 1) for k in range(count)]


@dataclass(frozen=True)
class RMAC:
    """Pooling of feature maps to descriptors of length 1."""

    levels: int = LEVELS  # sizes of regions
    whole: bool = False  # whether the whole map is one more region, as in ``cirtorch``
    # (D,), is subtracted from a region's vector of length 1; None: no whitening
    mean: Tensor | None = None
    projection: Tensor | None = None  # (D, k), multiplies it then from the right
    digest: str = ""  # SHA-256 of the whitening's file

    @classmethod
    def of(cls, channels: int, *, levels: int, whole: bool, whitening: str) -> RMAC:
        """The pooling of maps with D ``channels`` that a technique's settings describe.

        ``whitening`` is nothing, or a weights file with ``mean`` (D,) and ``projection`` (D, k),
        learned on images of other places: on the map's own it hurts.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: for no level, a damaged file, or one of another number of channels.
        """
        at_least("the levels of R-MAC", levels, 1, most=16)
        if not whitening:
            return cls(levels, whole)
        file = read_weights(whitening)
        mean = torch.from_numpy(file.layer("R-MAC", "mean", channels))
        projection = torch.from_numpy(file.layer("R-MAC", "projection", channels, None))
        return cls(levels, whole, mean, projection, file.digest)

    def parameters(self) -> Parameters:
        """All that descriptors depend on, for :meth:`Technique.parameters`."""
        return {"levels": self.levels, "whole": self.whole, "whitening": self.digest}

    def __call__(self, features: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C), or (B, k) with whitening; zeros where the features are."""
        height, width = features.shape[2:]
        maxima = [
            features[:, :, row : row + side, column : column + side].amax((2, 3))
            for row, column, side in regions(height, width, self.levels)
        ]
        if self.whole:
            maxima.append(features.amax((2, 3)))
        vectors = F.normalize(torch.stack(maxima, dim=1), dim=2)  # (B, regions, C)
        if self.mean is not None and self.projection is not None:
            vectors = F.normalize((vectors - self.mean) @ self.projection, dim=2)
        return F.normalize(vectors.sum(1), dim=1)


class RMACTechnique(Technique):
    """R-MAC on VGG16 or AlexNet, of the image in its own size; length 1, cosine.

    Args:
        argument: ``levels=LEVELS``, ``whole=yes``, ``whitening=FILE``, with colons between.
        weights: ImageNet's, in a file of :mod:`amusic_gym.techniques.backbones`. None ship.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: without weights, for a file that is damaged or has other layers, or a whitening
            of another number of channels.
    """

    name = "R-MAC"

    def __init__(self, argument: str = "", weights: str | Path | None = None) -> None:
        given = parsed(argument, **SETTINGS)
        if weights is None:
            raise ValueError(
                "R-MAC needs weights of VGG16 or AlexNet, which do not ship: "
                "--weights rmac=imagenet-vgg-verydeep-16.mat"
            )
        file = read_weights(weights)
        self._digest = file.digest
        self._backbone = load_backbone(file)
        self._pooling = RMAC.of(self._backbone.channels, **given)

    def parameters(self) -> Parameters:
        """The digest of the weights' file, and the pooling's settings."""
        return {"weights": self._digest, **self._pooling.parameters()}

    def describe(self, image: Image) -> Descriptor:
        """(C,) of length 1, or (k,) with a whitening."""
        descriptor: Descriptor = self._pooling(self._backbone.features(image))[0].numpy()
        return descriptor
