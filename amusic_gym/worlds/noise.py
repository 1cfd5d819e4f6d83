"""Random numbers by name, and fractal fields from which all materials are made."""

import zlib
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Generator = np.random.Generator
FIELD = 512  # rows and columns of a fractal field; it tiles


def generator(*keys: int | str) -> Generator:
    """Random numbers that depend on the keys only, the same in any order and process."""
    words = [zlib.crc32(k.encode()) if isinstance(k, str) else int(k) + (1 << 32) for k in keys]
    return np.random.default_rng(words)


@lru_cache(maxsize=32)
def fractal(exponent: float, index: int = 0) -> Floats:
    """(512, 512) tileable field of mean 0 and deviation 1 with amplitude ~ frequency^-exponent.

    Natural images have an exponent near 1; 0.5 is gritty, 1.5 cloudy.
    """
    rng = generator("fractal", int(exponent * 1000), index)
    rows = np.fft.fftfreq(FIELD)[:, None] * FIELD
    columns = np.fft.rfftfreq(FIELD)[None, :] * FIELD
    frequency = np.hypot(rows, columns)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((FIELD, FIELD))) / frequency**exponent
    field = np.fft.irfft2(spectrum, (FIELD, FIELD))
    return np.asarray((field - field.mean()) / field.std(), np.float32)


def patch(
    rng: Generator, height: int, width: int, exponent: float = 1.0, zoom: float = 1
) -> Floats:
    """A random piece (height, width) of a fractal field; ``zoom`` > 1 enlarges its features."""
    field = fractal(exponent, int(rng.integers(3)))
    rows = int(np.ceil(height / zoom)) + 1
    columns = int(np.ceil(width / zoom)) + 1
    top, left = int(rng.integers(FIELD)), int(rng.integers(FIELD))
    piece = field.take(range(top, top + rows), 0, mode="wrap")
    piece = piece.take(range(left, left + columns), 1, mode="wrap")
    if zoom == 1:
        return np.ascontiguousarray(piece[:height, :width])
    full = (int(np.ceil(columns * zoom)), int(np.ceil(rows * zoom)))
    enlarged = cv2.resize(piece, full, interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(enlarged[:height, :width], np.float32)
