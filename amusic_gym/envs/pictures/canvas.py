"""A sheet to draw on with OpenCV: boxes, text that fits, photographs, dots."""

from __future__ import annotations

import unicodedata
from functools import lru_cache
from itertools import product
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

INK, GREY, LINE, PAPER = "#222222", "#6B6B6B", "#C8C8C8", "#FFFFFF"
FONT = cv2.FONT_HERSHEY_SIMPLEX
SMALL, NORMAL, LARGE = 0.40, 0.46, 0.58  # sizes of text, as OpenCV counts them

Anchor = Literal["left", "centre", "right"]


class Box(NamedTuple):
    """Pixels from ``left``, ``top`` up to but not with ``right``, ``bottom``."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        """Pixels across."""
        return self.right - self.left

    @property
    def height(self) -> int:
        """Pixels down."""
        return self.bottom - self.top

    def inside(self, margin: int) -> Box:
        """The box less a margin on every side."""
        return Box(self.left + margin, self.top + margin, self.right - margin, self.bottom - margin)


@lru_cache(maxsize=256)
def bgr(colour: str) -> tuple[int, int, int]:
    """``"#RRGGBB"`` as OpenCV wants it."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return blue, green, red


@lru_cache(maxsize=1024)
def plain(text: str) -> str:
    """The text in the letters that OpenCV's font has: accents go, other scripts become "?"."""
    folded = unicodedata.normalize("NFKD", text)
    kept = (letter for letter in folded if not unicodedata.combining(letter))
    return "".join(letter if " " <= letter <= "~" else "?" for letter in kept)


@lru_cache(maxsize=4096)
def text_width(text: str, size: float) -> int:
    """Pixels across."""
    return int(cv2.getTextSize(text, FONT, size, 1)[0][0])


@lru_cache(maxsize=1024)
def fitted(text: str, width: int, size: float) -> str:
    """The text, or as much of it as fits into ``width`` pixels with two dots behind."""
    text = plain(text)
    if text_width(text, size) <= width:
        return text
    while text and text_width(text + "..", size) > width:
        text = text[:-1]
    return text + ".." if text else ""


class Canvas:
    """An image (height, width, 3) uint8 BGR to draw on.

    Attributes:
        pixels: the image.
    """

    def __init__(self, width: int, height: int) -> None:
        self.pixels: NDArray[np.uint8] = np.full((height, width, 3), 255, np.uint8)

    def text(
        self,
        words: str,
        x: int,
        y: int,
        *,
        width: int = 10_000,
        size: float = NORMAL,
        colour: str = INK,
        anchor: Anchor = "left",
    ) -> int:
        """Write on the baseline ``y`` from, around or up to ``x``; returns the pixels taken."""
        words = fitted(words, width, size)
        taken = text_width(words, size)
        start = {"left": x, "centre": x - taken // 2, "right": x - taken}[anchor]
        cv2.putText(self.pixels, words, (start, y), FONT, size, bgr(colour), lineType=cv2.LINE_AA)
        return taken

    def fill(self, box: Box, colour: str) -> None:
        """Fill a box."""
        if box.width > 0 and box.height > 0:  # OpenCV draws a pixel where there is none
            corner, opposite = (box.left, box.top), (box.right - 1, box.bottom - 1)
            cv2.rectangle(self.pixels, corner, opposite, bgr(colour), cv2.FILLED)

    def outline(self, box: Box, colour: str, thickness: int = 1) -> None:
        """Draw a box's edge, inside it."""
        left, top, right, bottom = box
        for edge in (
            Box(left, top, right, top + thickness),
            Box(left, bottom - thickness, right, bottom),
            Box(left, top, left + thickness, bottom),
            Box(right - thickness, top, right, bottom),
        ):
            self.fill(edge, colour)

    def photograph(self, image: NDArray[np.uint8], box: Box) -> Box:
        """Show an image whole and undistorted in the middle of a box; returns where it is."""
        height, width = image.shape[:2]
        scale = min(box.width / width, box.height / height)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        left = box.left + (box.width - size[0]) // 2
        top = box.top + (box.height - size[1]) // 2
        shown = cv2.resize(image, size, interpolation=method)
        if shown.ndim == 2:
            shown = cv2.cvtColor(shown, cv2.COLOR_GRAY2BGR)
        self.pixels[top : top + size[1], left : left + size[0]] = shown[..., :3]
        return Box(left, top, left + size[0], top + size[1])

    def dots(
        self, x: NDArray[Any], y: NDArray[Any], colours: NDArray[np.uint8], size: int, box: Box
    ) -> None:
        """Squares of ``size`` pixels around points (n,), in ``colours`` (n, 3), inside ``box``."""
        reach = range(-(size // 2), size - size // 2)
        for down, across in product(reach, reach):
            rows, columns = y + down, x + across
            inside = (rows >= box.top) & (rows < box.bottom)
            inside &= (columns >= box.left) & (columns < box.right)
            self.pixels[rows[inside], columns[inside]] = colours[inside]

    def line(self, x: NDArray[Any], y: NDArray[Any], colour: str, thickness: int = 1) -> None:
        """A line through points (n,)."""
        points = np.stack([x, y], axis=1).astype(np.int32)
        cv2.polylines(
            self.pixels, [points], False, bgr(colour), thickness=thickness, lineType=cv2.LINE_AA
        )

    def disc(self, x: int, y: int, radius: int, colour: str, edge: str = INK) -> None:
        """A filled circle with an edge."""
        cv2.circle(self.pixels, (x, y), radius, bgr(colour), -1, cv2.LINE_AA)
        cv2.circle(self.pixels, (x, y), radius, bgr(edge), 1, cv2.LINE_AA)

    def rgb(self) -> NDArray[np.uint8]:
        """A copy of the image in red, green, blue."""
        image: NDArray[np.uint8] = cv2.cvtColor(self.pixels, cv2.COLOR_BGR2RGB)  # type: ignore[assignment]
        return image
