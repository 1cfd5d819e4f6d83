"""Roofs, and the plain side walls under them."""

from __future__ import annotations

import cv2
import numpy as np

from amusic_gym.worlds.facades import SIGNS, Style, courses, extras, lettering, window
from amusic_gym.worlds.noise import generator, patch
from amusic_gym.worlds.paint import Paint, pick, vary


def roof(seed: int, number: int, wide: float, deep: float, season: str) -> Paint:
    """Tiles of a roof seen from the street."""
    rng = generator(seed, "roof", number)
    tile = pick(rng, ((60, 75, 130), (70, 70, 75), (55, 60, 95), (90, 95, 95)))
    paint = Paint(wide, deep, tile, texels=16)
    y = np.arange(paint.rows)[:, None] / 16 / 0.33
    x = np.arange(paint.columns)[None, :] / 16 / 0.3
    ribs = np.cos(2 * np.pi * x) * 0.6 + np.where((y % 1) < 0.3, -1.3, 0.4)
    paint.shade(ribs.astype(np.float32), 0.14)
    for _ in range(int(rng.integers(0, 3))):
        wx = rng.uniform(0.5, max(0.6, wide - 1.5))
        paint.box(wx, deep * 0.3, wx + 0.9, deep * 0.65, (190, 180, 170))
    paint.weather(rng)
    if season == "winter":
        cover = patch(rng, paint.rows, paint.columns, 1.3, zoom=1.5) > -0.9
        paint.colour[cover] = 232
        paint.shade(patch(rng, paint.rows, paint.columns, 1.2), 0.03)
    return paint


def blank_side(seed: int, number: int, style: Style, deep: float, high: float) -> Paint:
    """A side wall: the material, few windows, perhaps an old advertisement."""
    rng = generator(seed, "side", number)
    paint = Paint(deep, high, vary(rng, style.wall, 8), texels=20)
    courses(paint, rng, style.material)
    if rng.random() < 0.35:
        board = pick(rng, SIGNS)
        x, y = rng.uniform(0, max(0.1, deep - 3)), rng.uniform(1.5, max(1.6, high - 3))
        paint.box(x, y, x + 2.8, y + 1.8, board)
        lettering(paint, rng, x + 0.2, y + 0.9, 2.3, 0.5, board)
    for floor in range(int(high / style.storey)):
        if rng.random() < 0.5:
            x = rng.uniform(0.5, max(0.6, deep - 1.5))
            window(
                paint, rng, x, floor * style.storey + 1.0, style, False, bool(rng.random() < 0.3)
            )
    extras(paint, rng, deep, high)
    paint.weather(rng, 0.07, 0.16)
    cv2.GaussianBlur(paint.colour, (3, 3), 0.5, dst=paint.colour)
    return paint
