"""GIST: energies of Gabor filters on a coarse grid (Oliva and Torralba, 2001)."""

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.preparation import check_image
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique

BLOCKS = 4  # rows and columns of the grid over which energies are averaged
PREFILTER = 4.0  # cycles per image below which the prefilter takes contrast away
MARGIN = 5  # pixels that the prefilter's input is mirrored by
Floats = NDArray[np.float64]


class _GIST(Technique):
    """What both forms of GIST share."""

    orientations: tuple[int, ...]  # filters of each scale, fine to coarse

    def parameters(self) -> Parameters:
        """Grid, prefilter and orientations."""
        orientations = ",".join(map(str, self.orientations))
        return {"blocks": BLOCKS, "prefilter": PREFILTER, "orientations": orientations}

    def match(self, query: Descriptor, references: Descriptor) -> NDArray[np.float32]:
        """(B,) Euclidean distances with the sign changed, so that higher is more similar."""
        distances: NDArray[np.float32] = np.linalg.norm(references - query, axis=1)
        return -distances


class GIST(_GIST):
    """GIST of the grey image at 128×128; descriptors of 4 · 8 · 16 = 512 values, −L2.

    The settings are ``LMgist``'s defaults (LabelMe toolbox), which Hierarchical Multi-Process
    Fusion (Hausler and Milford 2020) uses: mean of the channels, the shorter side to 128 by linear
    interpolation, the middle cut out, grey values stretched to 0–255; four scales of eight
    orientations; borders mirrored by 32 pixels.
    """

    name = "GIST"
    orientations = (8, 8, 8, 8)

    def describe(self, image: Image) -> Descriptor:
        """(512,); near zero for an image without contrast."""
        check_image(image)
        grey = image.mean(axis=2, dtype=np.float64)
        height, width = grey.shape
        scale = 128 / min(height, width)
        size = (max(128, round(width * scale)), max(128, round(height * scale)))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR)
        top, left = (grey.shape[0] - 128) // 2, (grey.shape[1] - 128) // 2
        grey = grey[top : top + 128, left : left + 128]
        span = np.ptp(grey)
        grey = (grey - grey.min()) * (255 / span if span > 0 else 0.0)
        return energies(prefiltered(grey[np.newaxis]), self.orientations, pad=32)


class LearGIST(_GIST):
    """GIST of the colour image in its own size; descriptors of 3 · 20 · 16 = 960 values, −L2.

    The settings are those of INRIA's ``lear_gist``: red, green and blue each by three scales of 8,
    8 and 4 orientations, without mirrored borders. Its time grows with the image: bring large
    images to one small size first.
    """

    name = "GIST-lear"
    orientations = (8, 8, 4)

    def describe(self, image: Image) -> Descriptor:
        """(960,), red first; near zero for an image without contrast."""
        check_image(image)
        height, width = image.shape[:2]
        if min(height, width) < BLOCKS:  # a block needs a pixel
            image = cv2.resize(image, (max(width, BLOCKS), max(height, BLOCKS)))  # type: ignore[assignment]
        colours = image[:, :, ::-1].transpose(2, 0, 1).astype(np.float64)  # BGR -> (3, H, W) RGB
        return energies(prefiltered(colours), self.orientations)


def prefiltered(channels: Floats) -> Floats:
    """Images with their local contrast brought to one level, (C, H, W) -> (C, H, W).

    The local deviation is that of the mean over the channels.
    """
    mirror = ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN))
    logs = np.pad(np.log1p(channels), mirror, "symmetric")
    rows, columns = _frequencies(logs[0].shape)
    low = np.exp(-(rows**2 + columns**2) * math.log(2) / PREFILTER**2)

    def blurred(x: Floats) -> Floats:
        return np.fft.ifft2(np.fft.fft2(x) * low).real

    high = logs - blurred(logs)
    deviation = np.sqrt(np.abs(blurred(high.mean(axis=0) ** 2)))
    inner = slice(MARGIN, -MARGIN)
    whitened: Floats = (high / (0.2 + deviation))[:, inner, inner]
    return whitened


def energies(
    channels: Floats, orientations: tuple[int, ...], *, blocks: int = BLOCKS, pad: int = 0
) -> Descriptor:
    """Mean responses of Gabor filters in a grid of blocks to :func:`prefiltered` (C, H, W).

    ``orientations`` are the filters of each scale, fine to coarse; borders are mirrored by ``pad``
    pixels.

    Returns:
        (C · filters · blocks²,): channel slowest, then filter, then column, then row of the grid.
    """
    mirrored = np.pad(channels, ((0, 0), (pad, pad), (pad, pad)), "symmetric")
    height, width = channels.shape[1:]
    spectra = np.fft.fft2(mirrored)
    rows, columns = ((np.arange(blocks) * n) // blocks for n in (height, width))
    areas = np.outer(np.diff(columns, append=width), np.diff(rows, append=height))
    found = np.empty((len(channels), sum(orientations), blocks, blocks))
    for i, transfer in enumerate(_gabor_filters(mirrored[0].shape, orientations)):
        responses = np.abs(np.fft.ifft2(spectra * transfer))
        responses = responses[:, pad : pad + height, pad : pad + width]
        sums = np.add.reduceat(np.add.reduceat(responses, rows, axis=1), columns, axis=2)
        found[:, i] = sums.transpose(0, 2, 1) / areas
    return found.ravel().astype(np.float32)


def _frequencies(shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Cycles per image along the rows (H, 1) and the columns (1, W), in the order of an FFT."""
    along, across = (np.asarray(np.fft.fftfreq(n, 1 / n), np.float64) for n in shape)
    return along[:, np.newaxis], across[np.newaxis]


def _gabor_filters(shape: tuple[int, ...], orientations: tuple[int, ...]) -> Iterator[Floats]:
    """Transfer functions (H, W), scale by scale."""
    height, width = shape
    rows, columns = _frequencies(shape)
    radius, angle = np.hypot(rows, columns), np.arctan2(rows, columns)
    for scale, count in enumerate(orientations):
        centre = 0.3 / 1.85**scale  # cycles per pixel
        radial = (radius / height / centre - 1) * (radius / width / centre - 1)
        for step in range(count):
            turned = angle + math.pi * step / count
            turned = np.where(turned > math.pi, turned - 2 * math.pi, turned)
            spread = 2 * math.pi * 16 * count**2 / 32**2
            yield np.exp(-3.5 * radial - spread * turned**2)
