"""A texture while it is being painted, in metres."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.worlds.noise import Floats, Generator, patch

Colour = tuple[float, float, float]  # blue, green, red, 0-255
TEXELS = 26  # texels per metre of walls and things


class Paint:
    """Colour, alpha and glow of a surface, ``width`` x ``height`` metres, y from the ground up.

    Without a ``colour`` it begins transparent; there are so many ``texels`` per metre.
    """

    def __init__(
        self, width: float, height: float, colour: Colour | None = None, texels: float = TEXELS
    ) -> None:
        self.texels = texels
        self.columns = max(2, round(width * texels))
        self.rows = max(2, round(height * texels))
        self.colour = np.zeros((self.rows, self.columns, 3), np.uint8)
        self.alpha = np.zeros((self.rows, self.columns), np.uint8)
        self.glow = np.zeros((self.rows, self.columns), np.uint8)
        if colour is not None:
            self.colour[:] = colour
            self.alpha[:] = 255

    def at(self, x: float, y: float) -> tuple[int, int]:
        """Texel (column, row) of a point."""
        return round(x * self.texels), round(self.rows - y * self.texels)

    def box(
        self, x0: float, y0: float, x1: float, y1: float, colour: Colour, glow: float = 0
    ) -> None:
        """Fill a rectangle; ``glow`` 0-255 replaces what was there."""
        (left, bottom), (right, top) = self.at(x0, y0), self.at(x1, y1)
        left, top = max(0, left), max(0, top)
        rows, columns = slice(top, max(top + 1, bottom)), slice(left, max(left + 1, right))
        self.colour[rows, columns] = colour
        self.alpha[rows, columns] = 255
        self.glow[rows, columns] = glow

    def polygon(self, points: Sequence[tuple[float, float]], colour: Colour) -> None:
        """Fill a polygon."""
        corners = np.array([self.at(x, y) for x, y in points], np.int32)
        cv2.fillPoly(self.colour, [corners], colour)
        cv2.fillPoly(self.alpha, [corners], 255)
        cv2.fillPoly(self.glow, [corners], 0)

    def disk(
        self, x: float, y: float, across: float, up: float, colour: Colour, glow: float = 0
    ) -> None:
        """Fill an ellipse of the given half axes."""
        axes = (max(1, round(across * self.texels)), max(1, round(up * self.texels)))
        for target, value in ((self.colour, colour), (self.alpha, 255), (self.glow, glow)):
            cv2.ellipse(target, self.at(x, y), axes, 0, 0, 360, value, -1)

    def line(self, x0: float, y0: float, x1: float, y1: float, wide: float, colour: Colour) -> None:
        """Draw a stroke ``wide`` metres wide."""
        thick = max(1, round(wide * self.texels))
        begin, end = self.at(x0, y0), self.at(x1, y1)
        cv2.line(self.colour, begin, end, colour, thick, cv2.LINE_AA)
        cv2.line(self.alpha, begin, end, 255, thick, cv2.LINE_AA)

    def shade(self, field: Floats, strength: float) -> None:
        """Multiply the colour by 1 + strength * field."""
        factor = np.clip(1 + strength * field, 0.2, 2.2)
        self.colour[:] = np.clip(self.colour * factor[..., None], 0, 255)

    def weather(self, rng: Generator, grain: float = 0.06, stains: float = 0.12) -> None:
        """Grain, stains and soot: what keeps a real surface from being plain."""
        self.shade(patch(rng, self.rows, self.columns, 0.5), grain)
        self.shade(patch(rng, self.rows, self.columns, 1.2, zoom=1.7), stains)

    def image(self) -> NDArray[np.uint8]:
        """(H, W, 5) uint8: blue, green, red, alpha, glow, as `levels.pyramid` takes it."""
        return np.dstack([self.colour, self.alpha, self.glow])


def vary(rng: Generator, colour: Colour, amount: float = 12) -> Colour:
    """A colour near ``colour``: lighter or darker, and a little off."""
    shift, *off = rng.standard_normal(4).tolist()
    blue, green, red = (
        min(max(value + amount * (shift + 0.4 * own), 4.0), 250.0)
        for value, own in zip(colour, off, strict=True)
    )
    return blue, green, red


def dim(colour: Colour, factor: float) -> Colour:
    """A colour times a factor."""
    return factor * colour[0], factor * colour[1], factor * colour[2]


def pick(rng: Generator, items: Sequence[Colour]) -> Colour:
    """One of some colours, varied."""
    return vary(rng, items[int(rng.integers(len(items)))])
