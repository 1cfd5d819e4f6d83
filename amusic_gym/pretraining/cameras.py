"""Random cameras: what rendered images go through so that networks do not learn the renderer.

Real traverses are each recorded by one camera in one light: what a traverse's images share is a
:class:`RandomCamera`, drawn once per traverse. What changes from frame to frame is drawn per image.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]

WIDTH, HEIGHT = 160, 120
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
GRID = np.stack(
    np.meshgrid(*(np.linspace(-1, 1, size, dtype=np.float32) for size in (WIDTH, HEIGHT))), axis=2
)
"""(HEIGHT, WIDTH, 2) coordinates of the pixels, -1 to 1 both ways."""
FROM_MIDDLE = np.minimum((GRID**2).sum(axis=2) / 2, 1)
GRAIN = np.random.default_rng(7).standard_normal(1_000_000, np.float32)
"""Noise to take pieces of: quicker than to draw it for each image."""


@dataclass(frozen=True)
class RandomCamera:
    """What all images of a traverse share."""

    bend: float  # radial distortion; above 0 a fish-eye's
    corners: Floats  # (4, 2) what it sees of a picture, as `warp` takes it
    gains: tuple[float, float, float]  # factor of each channel
    colour: float  # 0 grey, 1 as rendered
    gamma: float  # exponent of the tone curve
    contrast: float  # factor around the middle grey
    light: float  # added to all values, of 255
    vignette: float  # how much darker the corners are, 0 to 1
    blur: float  # standard deviation in pixels; 0 none
    rows: int  # of a coarse sensor; the image is HEIGHT high again after it
    noise: float  # standard deviation of each value, of 255


def warp(image: Image, corners: Floats, bend: float = 0.0) -> Image:
    """The image (H, W[, 3]) seen through a bent lens by a camera that moved, (HEIGHT, WIDTH[, 3]).

    ``corners`` (4, 2): where the picture's lie in the image, -1 to 1 both ways, in the order of
    ``CORNERS``. Beyond its edges the image is mirrored. ``bend``: see :class:`RandomCamera`.
    """
    points: Any = GRID  # (H, W, 2); OpenCV's functions are typed too widely
    if bend:
        squared = (points**2).sum(axis=2, keepdims=True)
        points = points * ((1 + bend * squared) / (1 + bend))
    matrix = cv2.getPerspectiveTransform(CORNERS, corners.astype(np.float32))
    points = cv2.perspectiveTransform(points.reshape(1, -1, 2), matrix).reshape(GRID.shape)
    half = np.array([image.shape[1] - 1, image.shape[0] - 1], np.float32) / 2
    where = ((points + 1) * half).astype(np.float32)
    seen = cv2.remap(image, where, np.empty(0), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(seen, np.uint8)


def seen_corners(rng: np.random.Generator, zoom: float, jitter: float) -> Floats:
    """Corners of a view that shows the share ``zoom`` of a picture.

    The view lies anywhere inside the picture; then each corner moves by at most ``jitter`` both
    ways (of half the width or height).
    """
    middle = rng.uniform(zoom - 1, 1 - zoom, 2)
    corners = CORNERS * zoom + middle + rng.uniform(-jitter, jitter, (4, 2))
    return np.asarray(corners, np.float32)


def draw_camera(rng: np.random.Generator) -> RandomCamera:
    """A camera at random: most are ordinary in most respects."""

    def sometimes(share: float, low: float, high: float, usual: float) -> float:
        drawn = float(rng.uniform(low, high))
        return drawn if rng.random() < share else usual

    gains = np.exp(rng.normal(0, 0.15, 3))
    return RandomCamera(
        bend=sometimes(0.5, -0.1, 0.6, 0.0),
        corners=seen_corners(rng, rng.uniform(0.8, 1), 0.05),
        gains=(float(gains[0]), float(gains[1]), float(gains[2])),
        colour=sometimes(0.5, 0.0, 0.8, 1.0) if rng.random() > 0.25 else 0.0,
        gamma=float(np.exp(rng.normal(0, 0.35))),
        contrast=float(np.exp(rng.normal(0, 0.3))),
        light=float(rng.normal(0, 15)),
        vignette=sometimes(0.4, 0.1, 0.8, 0.0),
        blur=sometimes(0.4, 0.4, 1.6, 0.0),
        rows=int(sometimes(0.3, 32, 100, HEIGHT)),
        noise=sometimes(0.6, 1.0, 12.0, 0.0),
    )


def shading(rng: np.random.Generator, strength: float) -> Floats:
    """(HEIGHT, WIDTH) smooth factor around 1: light and shadow that the renderer lacks."""
    coarse = rng.normal(0, strength, (rng.integers(2, 6), rng.integers(2, 6)))
    factor = np.exp(np.clip(coarse, -1.2, 1.2)).astype(np.float32)
    smooth = cv2.resize(factor, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    return np.asarray(smooth, np.float32)


def occlude(image: Image, rng: np.random.Generator, share: float) -> None:
    """Cover up to a ``share`` of the picture, in place, by a plain patch."""
    high, wide = (rng.uniform(0.1, share**0.5, 2) * (HEIGHT, WIDTH)).astype(int)
    top, left = rng.integers(HEIGHT - high), rng.integers(WIDTH - wide)
    image[top : top + high, left : left + wide] = rng.integers(0, 256, 3)


def tone_curve(camera: RandomCamera, light: float) -> Image:
    """(256,) what a camera makes of each value; ``light`` is this frame's own."""
    values = 255 * (np.arange(256) / 255) ** camera.gamma
    values = (values - 128) * camera.contrast + 128 + camera.light + light
    return np.clip(values, 0, 255).astype(np.uint8)


def photograph(
    image: Image, camera: RandomCamera, rng: np.random.Generator, jitter: float = 0.04
) -> Image:
    """One frame as a camera takes it: (H, W, 3) BGR -> (HEIGHT, WIDTH, 3) BGR."""
    shaken = rng.uniform(-jitter, jitter, 2) + rng.uniform(-jitter, jitter, (4, 2)) / 2
    corners = np.asarray(camera.corners + shaken, np.float32)
    taken: Any = warp(image, corners, camera.bend)
    if rng.random() < 0.25:
        occlude(taken, rng, 0.15)
    factor = shading(rng, 0.25)
    if camera.vignette:
        factor *= 1 - camera.vignette * FROM_MIDDLE
    mixed = camera.colour * np.eye(3) + (1 - camera.colour) / 3  # (3, 3)
    taken = cv2.transform(taken, np.asarray(camera.gains)[:, None] * mixed)
    taken = cv2.multiply(taken, cv2.merge([factor] * 3), dtype=cv2.CV_8U)
    if camera.rows < HEIGHT:
        small = (camera.rows * WIDTH // HEIGHT, camera.rows)
        taken = cv2.resize(taken, small, interpolation=cv2.INTER_AREA)
        taken = cv2.resize(taken, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    if camera.blur:
        taken = cv2.GaussianBlur(taken, (0, 0), camera.blur)
    taken = cv2.LUT(taken, tone_curve(camera, rng.normal(0, 5)))
    if camera.noise:
        first = rng.integers(len(GRAIN) - taken.size)
        grain = GRAIN[first : first + taken.size].reshape(taken.shape)
        taken = cv2.scaleAdd(grain, camera.noise, taken.astype(np.float32))
        taken = np.clip(taken, 0, 255).astype(np.uint8)
    return np.asarray(taken, np.uint8)
