"""Conditions for images of real places: night, blur, shift, fog, rain, glare.

What a query would have looked like under worse conditions, computed from the image alone: no depth,
no model of the scene. So it is cruder than `amusic_gym.worlds`, and works on any image.

A condition is written ``NAME`` or ``NAME:STRENGTH``, the strength in (0, 1], `STRENGTH` unless
given; several at once are joined by ``+`` and applied in that order, as in ``night:0.5+rain``.
``plain`` leaves the image as it is and has no strength.

What is drawn (noise, streaks, the place of the sun) depends on the seed, the frame number and the
condition's name only. So an image is the same in whatever order the frames are asked for, and a
greater strength changes the same image by more.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.protocol import Image
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import suggest

STRENGTH = 0.7  # of a condition that is written without one
PLAIN = "plain"

_Floats = NDArray[np.float32]


@dataclass(frozen=True)
class _Chance:
    """The random generators of a condition: one for the frame, one for the whole drive."""

    frame: np.random.Generator
    drive: np.random.Generator


def _night(image: _Floats, strength: float, chance: _Chance) -> _Floats:
    """Less light, dark parts darker still, a bluish cast, and noise as of a high sensitivity.

    At strength 1, a value v in [0, 1] becomes 0.2 v ** 2.2, with noise of a standard deviation of
    0.05 where it is black and 0.07 where the image was white; noise grows with the square of the
    strength.
    """
    values = (image / 255.0) ** (1.0 + 1.2 * strength) * (1.0 - 0.8 * strength)
    values *= 1.0 + strength * np.array([0.1, 0.0, -0.1], np.float32)  # blue, green, red
    deviation = strength**2 * np.sqrt(0.0025 + 0.012 * values)
    noise = chance.frame.standard_normal(image.shape, np.float32)
    return np.asarray(255.0 * (values + deviation * noise), np.float32)


def _blur(image: _Floats, strength: float, chance: _Chance) -> _Floats:
    """The camera turns during the exposure: every row is averaged over 12 % of the width."""
    import cv2

    length = 1.0 + 0.12 * strength * image.shape[1]  # pixels
    side = math.ceil((length - 1.0) / 2.0)
    kernel = np.ones(2 * side + 1, np.float32)
    kernel[[0, -1]] = 1.0 - (2 * side + 1 - length) / 2.0  # the outermost count in part
    rows, columns = kernel / kernel.sum(), np.ones(1, np.float32)
    blurred = cv2.sepFilter2D(image, -1, rows, columns, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, np.float32)


def _shift(image: _Floats, strength: float, chance: _Chance) -> _Floats:
    """Another lane: 30 % of the width go out of view at one side, and the rest fills the image.

    The side is the same on the whole drive.
    """
    import cv2

    height, width = image.shape[:2]
    scale = 1.0 / (1.0 - 0.3 * strength)
    left = chance.drive.random() < 0.5
    matrix = np.array(
        [
            [scale, 0.0, 0.0 if left else (1.0 - scale) * (width - 1)],
            [0.0, scale, (1.0 - scale) * (height - 1) / 2.0],
        ]
    )
    moved = cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.float32)


def _fog(image: _Floats, strength: float, chance: _Chance) -> _Floats:
    """Light grey in front of everything, denser above, where things are far, than at the bottom.

    At strength 1, 5 % of the contrast are left at the top and 37 % at the bottom.
    """
    height, width = image.shape[:2]
    rows = np.linspace(3.0, 1.0, height, dtype=np.float32)[:, None]
    phase = float(chance.frame.uniform(0.0, 2.0 * math.pi))
    columns = 1.0 + 0.15 * np.sin(np.linspace(0.0, math.pi, width, dtype=np.float32) + phase)
    left = np.exp(-strength * rows * columns)[:, :, None]  # (H, W, 1) contrast
    return np.asarray(image * left + 205.0 * (1.0 - left), np.float32)


def _rain(image: _Floats, strength: float, chance: _Chance) -> _Floats:
    """Bright slanting streaks before a duller image; their slant is that of the drive's wind."""
    import cv2

    height, width = image.shape[:2]
    length = max(3, height // 9)
    slant = float(chance.drive.uniform(-0.35, 0.35)) * length
    kernel = np.zeros((length, 2 * math.ceil(abs(slant)) + 1), np.float32)
    for row in range(length):
        kernel[row, round(kernel.shape[1] // 2 + slant * (row / (length - 1) - 0.5))] = 1.0
    drops = chance.frame.random((height, width), np.float32) < 0.012 * strength
    depth = chance.frame.uniform(60.0, 170.0, (height, width)).astype(np.float32)
    streaks = cv2.filter2D(drops * depth, -1, kernel, borderType=cv2.BORDER_CONSTANT)
    dull = (1.0 - 0.35 * strength) * image + 0.15 * strength * 120.0
    return np.asarray(dull + np.minimum(streaks, 180.0)[:, :, None], np.float32)


def _glare(image: _Floats, strength: float, chance: _Chance) -> _Floats:
    """A low sun in view, swaying with the camera: a disc, a halo, and a veil of stray light."""
    height, width = image.shape[:2]
    sun = chance.drive.uniform((0.15, 0.1), (0.85, 0.4)) + chance.frame.normal(0.0, 0.01, 2)
    across, down = sun.tolist()  # in widths, in heights
    x = np.linspace(0.0, 1.0, width, dtype=np.float32) - across
    y = np.linspace(0.0, 1.0, height, dtype=np.float32) - down
    away = (x[None, :] ** 2 + (y[:, None] * height / width) ** 2)[:, :, None]  # in widths, squared
    light = 400.0 * np.exp(-away / 0.006) + 190.0 * np.exp(-away / 0.12) + 50.0
    light = light * np.array([0.88, 0.97, 1.0], np.float32)  # blue, green, red
    return np.asarray(image * (1.0 - 0.4 * strength) + strength * light, np.float32)


CONDITIONS: dict[str, Callable[[_Floats, float, _Chance], _Floats]] = {
    PLAIN: lambda image, strength, chance: image,
    "night": _night,
    "blur": _blur,
    "shift": _shift,
    "fog": _fog,
    "rain": _rain,
    "glare": _glare,
}
"""Name → what it makes of (H, W, 3) float32 values from 0 to 255, which may leave that range."""


@dataclass(frozen=True)
class Condition:
    """One condition, or several at once."""

    parts: tuple[tuple[str, float], ...] = ()  # (name, strength), in order; none: plain

    @classmethod
    def parse(cls, text: str) -> Condition:
        """The condition that is written ``NAME[:STRENGTH][+NAME[:STRENGTH] ...]``.

        Raises:
            ValueError: for an unknown name, a strength that is not in (0, 1], or a ``plain`` with
                a strength.
        """
        if not isinstance(text, str):
            raise ValueError(f"condition is {text!r}; give a text, as 'night:0.5'")
        parts = []
        for part in text.split("+"):
            name, colon, number = (each.strip() for each in part.partition(":"))
            if name not in CONDITIONS:
                raise ValueError(suggest("condition", name, CONDITIONS))
            if name == PLAIN:
                if colon:
                    raise ValueError(f"condition {part.strip()!r}: plain has no strength; drop it")
                continue
            parts.append((name, _strength(part.strip(), number) if colon else STRENGTH))
        return cls(tuple(parts))

    def __str__(self) -> str:
        """As :meth:`parse` takes it, every strength given."""
        return "+".join(f"{name}:{strength!r}" for name, strength in self.parts) or PLAIN

    def apply(self, image: Image, *, seed: int, frame: int) -> Image:
        """The image (H, W, 3) uint8, blue-green-red, under this condition; itself if that is plain.

        ``seed`` is the drive's, ``frame`` the number of the image on it, both >= 0.

        Raises:
            ValueError: for another array, seed or frame.
        """
        seed, frame = whole("seed", seed, 0), whole("frame", frame, 0)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
            raise ValueError(
                f"image has shape {image.shape} and dtype {image.dtype}; give (H, W, 3) uint8"
            )
        for name, strength in self.parts:
            key = zlib.crc32(name.encode())
            chance = _Chance(
                np.random.default_rng([seed, key, 1, frame]),
                np.random.default_rng([seed, key, 0]),
            )
            values = CONDITIONS[name](image.astype(np.float32), strength, chance)
            image = np.rint(values.clip(0.0, 255.0)).astype(np.uint8)
        return image


def _strength(part: str, number: str) -> float:
    try:
        strength = float(number)
    except ValueError:
        strength = math.nan
    if not 0.0 < strength <= 1.0:
        raise ValueError(
            f"condition {part!r}: strength is {number!r}; give a number above 0 and up to 1"
        )
    return strength


@dataclass(frozen=True)
class Change:
    """A condition applied to one image of a traverse; its text names all that it depends on."""

    condition: Condition  # not plain
    seed: int  # of the drive
    frame: int  # number of the image on the drive

    def __str__(self) -> str:
        return f"{self.condition} seed {self.seed} frame {self.frame}"

    def apply(self, image: Image) -> Image:
        """The image, (H, W, 3) uint8, as the drive sees it."""
        return self.condition.apply(image, seed=self.seed, frame=self.frame)
