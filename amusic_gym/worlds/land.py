"""Rock, slopes, masonry, platforms and small furniture."""

import numpy as np

from amusic_gym.worlds.facades import STONE, courses
from amusic_gym.worlds.noise import generator, patch
from amusic_gym.worlds.paint import Colour, Paint, pick, vary
from amusic_gym.worlds.plants import BARK, leaf_colour

WHITE: Colour = (232.0, 230.0, 227.0)
METAL = ((160, 162, 165), (110, 125, 120), (80, 115, 160), (60, 62, 66), (150, 140, 90))


def rock(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """A rock face with cracks and ledges."""
    rng = generator(seed, "rock", number)
    paint = Paint(wide, high, vary(rng, (105, 112, 118), 12), texels=16)
    relief = patch(rng, paint.rows, paint.columns, 1.0, zoom=2.0)
    slope = np.diff(relief, axis=0, prepend=relief[:1]) + 0.6 * np.diff(
        relief, axis=1, prepend=relief[:, :1]
    )
    paint.shade(slope / (slope.std() + 1e-6), 0.22)
    cracks = np.abs(patch(rng, paint.rows, paint.columns, 1.1, zoom=1.5)) < 0.05
    paint.colour[cracks] = (paint.colour[cracks] * 0.45).astype(np.uint8)
    for _ in range(40):
        x, y = rng.uniform(0, wide), rng.uniform(0, high)
        tint = leaf_colour(rng, season, number) if season != "winter" else WHITE
        for _ in range(8):
            at = x + rng.normal(0, 0.3), y + rng.normal(0, 0.12)
            paint.disk(*at, 0.14, 0.1, vary(rng, tint, 14))
    paint.weather(rng, 0.08, 0.2)
    if season == "winter":
        ledges = relief + 0.5 * slope / (slope.std() + 1e-6) > 0.75
        paint.colour[ledges] = 230
    return paint


def slope(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """A grassy slope with scrub and earth."""
    rng = generator(seed, "slope", number)
    base: dict[str, Colour] = {"summer": (50, 105, 85), "autumn": (60, 100, 115), "winter": WHITE}
    paint = Paint(wide, high, base[season], texels=18)
    winter = season == "winter"
    bare = patch(rng, paint.rows, paint.columns, 1.1, zoom=2.0) > (1.2 if winter else 0.9)
    paint.colour[bare] = (75, 95, 110)
    dark: Colour = (35, 75, 58) if season == "summer" else (55, 85, 105)
    for _ in range(int(30 * wide)):
        x, y = rng.uniform(0, wide), rng.uniform(0, high)
        tint = vary(rng, BARK[1] if winter else dark, 18)
        if winter and rng.random() < 0.6:
            continue
        paint.line(x, y, x + rng.normal(0, 0.15), y + rng.uniform(0.1, 0.5), 0.06, tint)
    paint.weather(rng, *((0.02, 0.05) if winter else (0.1, 0.18)))
    return paint


def masonry(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """Blocks of stone or concrete."""
    rng = generator(seed, "masonry", number // 4)
    paint = Paint(wide, high, pick(rng, STONE), texels=18)
    courses(paint, rng, "stone" if rng.random() < 0.6 else "panel")
    paint.weather(rng, 0.08, 0.24)
    if season == "winter":
        paint.box(0, high - 0.12, wide, high, WHITE)
    return paint


def platform(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """The edge of a platform."""
    rng = generator(seed, "platform", number // 4)
    paint = Paint(wide, high, vary(rng, (135, 138, 142), 15), texels=20)
    courses(paint, rng, "panel")
    paint.weather(rng, 0.08, 0.2)
    paint.box(0, high - 0.15, wide, high, WHITE if season == "winter" else (200, 205, 208))
    return paint


def paving(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """The top of a platform."""
    rng = generator(seed, "paving", number // 4)
    paint = Paint(wide, high, vary(rng, (145, 148, 150), 15), texels=12)
    courses(paint, rng, "stone")
    paint.box(0, 0.5, wide, 0.62, (210, 215, 215))
    if season == "winter":
        paint.colour[patch(rng, paint.rows, paint.columns, 1.1, 2.0) > -0.8] = 228
    paint.weather(rng, 0.06, 0.12)
    return paint


def cabinet(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """A metal or wooden box with doors and drawers."""
    rng = generator(seed, "cabinet", number)
    tone = pick(rng, METAL)
    paint = Paint(wide, high, tone, texels=44)
    rows = int(rng.integers(1, 5))
    for row in range(rows):
        y = 0.05 + row * (high - 0.1) / rows
        for x in np.arange(0.03, wide - 0.1, 0.55):
            end = min(x + 0.53, wide - 0.03)
            paint.box(x, y, end, y + (high - 0.1) / rows - 0.03, vary(rng, tone, 9))
            paint.box((x + end) / 2 - 0.05, y + 0.1, (x + end) / 2 + 0.05, y + 0.13, (60, 60, 60))
    paint.weather(rng, 0.03, 0.06)
    return paint


def pot_plant(seed: int, season: str, number: int) -> Paint:
    """A plant in a pot, 0.7 x 1.5 m."""
    rng = generator(seed, "pot", number)
    paint = Paint(0.7, 1.5, texels=60)
    pot = pick(rng, ((50, 80, 150), (200, 200, 200), (60, 60, 60)))
    paint.polygon([(0.2, 0), (0.15, 0.38), (0.55, 0.38), (0.5, 0)], pot)
    green = vary(rng, (45, 105, 60), 15)
    for _ in range(70):
        angle, long = rng.normal(0, 0.7), rng.uniform(0.3, 1.05)
        x, y = 0.35 + 0.33 * np.sin(angle) * long, 0.36 + long * np.cos(angle)
        paint.line(0.35, 0.36, x, y, 0.012, (40, 80, 60))
        paint.disk(x, y, 0.06, 0.035, vary(rng, green, 20))
    return paint


def chair(seed: int, season: str, number: int) -> Paint:
    """A chair or stool, 0.8 x 0.9 m."""
    rng = generator(seed, "chair", number)
    paint = Paint(0.8, 0.9, texels=60)
    tone = pick(rng, ((50, 50, 160), (150, 90, 40), (50, 52, 55), (60, 140, 190), (80, 120, 60)))
    for x in (0.15, 0.62):
        paint.line(x, 0, x, 0.45, 0.04, (90, 92, 95))
    paint.box(0.1, 0.4, 0.7, 0.5, tone)
    paint.box(0.12, 0.58, 0.66, 0.88, vary(rng, tone, 14))
    paint.line(0.15, 0.4, 0.15, 0.85, 0.04, (90, 92, 95))
    return paint


def bin_(seed: int, season: str, number: int) -> Paint:
    """A waste bin or an extinguisher, 0.35 x 0.7 m."""
    rng = generator(seed, "bin", number)
    paint = Paint(0.35, 0.7, texels=70)
    tone = pick(rng, ((60, 60, 62), (140, 145, 145), (150, 90, 40), (40, 40, 180), (70, 140, 60)))
    paint.polygon([(0.06, 0), (0.02, 0.65), (0.33, 0.65), (0.29, 0)], tone)
    paint.box(0.0, 0.6, 0.35, 0.68, vary(rng, tone, 25))
    paint.shade(np.linspace(0.8, -1, paint.columns, dtype=np.float32)[None, :], 0.25)
    return paint
