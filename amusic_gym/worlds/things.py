"""Cars, people, poles, signs and furniture."""

import cv2
import numpy as np

from amusic_gym.worlds.facades import SIGNS, WALLS, courses, lettering
from amusic_gym.worlds.noise import generator
from amusic_gym.worlds.paint import Colour, Paint, dim, pick, vary

CAR = ((200, 200, 200), (40, 40, 42), (120, 120, 125), (130, 60, 30), (40, 40, 150),
       (90, 110, 70), (225, 228, 230), (60, 90, 120))  # fmt: skip
CLOTHES = ((60, 50, 45), (120, 70, 40), (50, 50, 130), (150, 150, 150), (60, 100, 60),
           (40, 130, 190), (90, 60, 90), (30, 30, 32))  # fmt: skip
GLASS: Colour = (70, 62, 55)
BLACK: Colour = (28, 28, 30)
SNOW: Colour = (236, 236, 236)


def car_side(seed: int, season: str, number: int) -> Paint:
    """Seen from the side: 4.3 x 1.5 m, or a van of 2 m."""
    body, van, paint = _car(seed, number, 4.3)
    high = 2.0 if van else 1.5
    roof = [(0.35, 0.9), (0.95, high), (2.7, high), (3.5, 0.92)]
    if van:
        roof = [(0.15, 0.9), (0.3, high), (3.3, high), (3.8, 1.0)]
    paint.polygon(roof, body)
    low = dim(body, 0.7)
    paint.polygon([(0.05, 0.3), (0.1, 0.95), (3.6, 0.97), (4.25, 0.75), (4.28, 0.3)], body)
    paint.polygon([(0.05, 0.3), (0.05, 0.5), (4.28, 0.5), (4.28, 0.3)], low)
    if not van:
        paint.polygon([(0.65, 0.95), (1.05, high - 0.1), (1.75, high - 0.1), (1.75, 0.95)], GLASS)
    paint.polygon([(1.85, 0.95), (1.85, high - 0.1), (2.65, high - 0.1), (3.3, 0.95)], GLASS)
    paint.line(1.8, 0.35, 1.8, 1.0, 0.03, low)
    for x in (0.85, 3.4):
        paint.disk(x, 0.33, 0.34, 0.33, BLACK)
        paint.disk(x, 0.33, 0.19, 0.19, (150, 150, 150))
    return _finished_car(paint, season, roof[1][0], roof[2][0], high)


def car_back(seed: int, season: str, number: int) -> Paint:
    """The rear, 1.8 m wide, of the same car."""
    body, van, paint = _car(seed, number, 1.8)
    high = 2.0 if van else 1.5
    paint.polygon(
        [(0.05, 0.25), (0.05, 0.95), (0.25, high), (1.55, high), (1.75, 0.95), (1.75, 0.25)], body
    )
    paint.polygon([(0.25, 0.98), (0.38, high - 0.12), (1.42, high - 0.12), (1.55, 0.98)], GLASS)
    for x in (0.08, 1.5):
        paint.box(x, 0.7, x + 0.22, 0.92, (40, 35, 170), 150)
        paint.box(x + 0.02, 0, x + 0.22, 0.3, BLACK)
    paint.box(0.6, 0.55, 1.2, 0.68, (215, 220, 220))
    paint.box(0.05, 0.25, 1.75, 0.42, dim(body, 0.6))
    return _finished_car(paint, season, 0.25, 1.55, high)


def _car(seed: int, number: int, wide: float) -> tuple[Colour, bool, Paint]:
    """Colour of a car, whether it is a van, and an empty picture."""
    rng = generator(seed, "car", number)
    body, van = pick(rng, CAR), rng.random() < 0.25
    return body, van, Paint(wide, 2.0 if van else 1.5, texels=40)


def _finished_car(paint: Paint, season: str, x0: float, x1: float, high: float) -> Paint:
    """Shaded from above, with snow on its roof in winter."""
    paint.shade(np.linspace(1, -1, paint.rows, dtype=np.float32)[:, None], 0.16)
    if season == "winter":
        paint.box(x0, high - 0.1, x1, high, SNOW)
    return paint


def train(seed: int, season: str, number: int) -> Paint:
    """The side of a carriage, 20 x 3.4 m."""
    rng = generator(seed, "train", number)
    body, stripe = pick(rng, SIGNS), pick(rng, SIGNS)
    paint = Paint(20, 3.4, body, texels=16)
    paint.box(0, 0.9, 20, 1.2, stripe)
    for x in np.arange(1.2, 18, 1.9):
        paint.box(x, 1.5, x + 1.4, 2.5, GLASS, 180)
    for x in (0.1, 6.5, 13.0, 18.9):
        paint.box(x, 0.1, x + 1.0, 2.7, vary(rng, stripe, 15))
    paint.box(0, 0, 20, 0.3, BLACK)
    paint.shade(np.linspace(0.6, -1, paint.rows, dtype=np.float32)[:, None], 0.15)
    return paint


def person(seed: int, season: str, number: int) -> Paint:
    """A standing or walking person, 0.9 x 1.8 m."""
    rng = generator(seed, "person", number)
    high = rng.uniform(1.55, 1.85)
    paint = Paint(0.9, 1.9, texels=44)
    top, legs = pick(rng, CLOTHES), pick(rng, CLOTHES)
    skin = pick(rng, ((130, 160, 205), (90, 120, 165), (60, 80, 115)))
    stride = rng.uniform(0.02, 0.22)
    for side in (-1, 1):
        paint.line(0.45 + side * 0.07, 0.5 * high, 0.45 + side * stride, 0.04, 0.15, legs)
        hand = 0.45 + side * (0.24 + 0.3 * stride)
        paint.line(0.45 + side * 0.2, 0.8 * high, hand, 0.47 * high, 0.1, top)
    long = 0.3 if season == "winter" else 0.45
    paint.polygon(
        [(0.26, long * high), (0.24, 0.82 * high), (0.66, 0.82 * high), (0.64, long * high)], top
    )
    paint.disk(0.45, 0.92 * high, 0.1, 0.13, skin)
    paint.disk(0.45, 0.96 * high, 0.11, 0.09, vary(rng, (40, 50, 60), 20))
    if rng.random() < 0.4:
        paint.box(0.66, 0.3 * high, 0.85, 0.5 * high, pick(rng, CLOTHES))
    paint.shade(np.linspace(-1, 1, paint.columns, dtype=np.float32)[None, :], 0.18)
    return paint


def pole(seed: int, season: str, number: int, high: float, wide: float) -> Paint:
    """A round pole, shaded."""
    rng = generator(seed, "pole", number)
    tone = pick(rng, ((110, 112, 115), (80, 90, 80), (70, 85, 100), (150, 152, 155)))
    paint = Paint(wide, high, tone, texels=max(12.0, 6 / wide))
    round_ = np.cos(np.linspace(-1.4, 1.9, paint.columns)) - 0.6
    paint.shade(round_.astype(np.float32)[None, :], 0.4)
    paint.weather(rng, 0.05, 0.1)
    return paint


def lamp_head(seed: int, season: str, number: int) -> Paint:
    """An arm with a lantern, 1.6 x 0.5 m, reaching right."""
    paint = Paint(1.6, 0.5, texels=40)
    paint.line(0.0, 0.1, 1.2, 0.38, 0.07, (95, 97, 100))
    paint.polygon([(1.0, 0.3), (1.1, 0.44), (1.55, 0.42), (1.58, 0.3)], (80, 82, 85))
    paint.box(1.05, 0.22, 1.55, 0.3, (190, 215, 225), 255)
    return paint


def sign(seed: int, season: str, number: int) -> Paint:
    """A road or rail sign on a post, 0.8 x 2.6 m."""
    rng = generator(seed, "sign", number)
    paint = Paint(0.9, 2.7, texels=44)
    paint.box(0.42, 0, 0.48, 2.5, (130, 132, 135))
    shape = int(rng.integers(4))
    if shape == 0:
        paint.disk(0.45, 2.25, 0.4, 0.4, (45, 45, 200))
        paint.disk(0.45, 2.25, 0.3, 0.3, (230, 230, 230))
    elif shape == 1:
        paint.polygon([(0.02, 1.9), (0.88, 1.9), (0.45, 2.65)], (45, 45, 200))
        paint.polygon([(0.2, 2.0), (0.7, 2.0), (0.45, 2.45)], (230, 230, 230))
    elif shape == 2:
        paint.box(0.05, 1.9, 0.85, 2.65, (170, 90, 30))
        paint.box(0.3, 2.05, 0.6, 2.5, (235, 235, 235))
    else:
        board = pick(rng, SIGNS)
        paint.box(0, 1.9, 0.9, 2.6, board)
        lettering(paint, rng, 0.08, 2.1, 0.75, 0.3, board)
    return paint


def board(seed: int, season: str, number: int, wide: float, high: float, glow: int) -> Paint:
    """A hoarding, poster or notice: a picture of shapes and words."""
    rng = generator(seed, "board", number)
    ground = pick(rng, (*SIGNS, (200, 190, 170), (150, 200, 225)))
    paint = Paint(wide, high, ground, texels=min(60.0, 160 / max(wide, high)))
    for _ in range(int(rng.integers(2, 7))):
        tint, x, y = pick(rng, SIGNS), rng.uniform(0, wide), rng.uniform(0.2 * high, high)
        size = rng.uniform(0.08, 0.35)
        if rng.random() < 0.5:
            paint.disk(x, y, size * wide, size * high, tint)
        else:
            paint.box(x, y - size * high, x + size * wide, y, tint)
    for row in range(int(rng.integers(1, 5))):
        y = high * (0.08 + 0.11 * row)
        lettering(paint, rng, 0.08 * wide, y, 0.85 * wide, 0.075 * high, ground)
    edge = 0.03 * max(wide, high)
    frame = vary(rng, (90, 90, 90), 40)
    for x in (0.0, wide - edge):
        paint.box(x, 0, x + edge, high, frame)
    for y in (0.0, high - edge):
        paint.box(0, y, wide, y + edge, frame)
    paint.glow[:] = glow
    return paint


def fence(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """Pickets, bars or mesh."""
    rng = generator(seed, "fence", number)
    paint = Paint(wide, high, texels=40)
    tone = pick(rng, ((225, 228, 228), (60, 62, 60), (70, 95, 125), (120, 122, 122)))
    gap, bar = ((0.14, 0.09), (0.13, 0.025), (0.45, 0.05))[int(rng.integers(3))]
    for x in np.arange(0.02, wide, gap):
        paint.box(x, 0, x + bar, high * rng.uniform(0.94, 1.0), vary(rng, tone, 10))
    for y in (0.2 * high, 0.82 * high):
        paint.box(0, y, wide, y + 0.06, tone)
    return paint


def low_wall(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """A garden wall."""
    rng = generator(seed, "wall", number)
    material = ("brick", "stone", "plaster")[int(rng.integers(3))]
    paint = Paint(wide, high, pick(rng, WALLS[material]))
    courses(paint, rng, material)
    paint.weather(rng, 0.08, 0.2)
    paint.box(0, high - 0.1, wide, high, SNOW if season == "winter" else (140, 145, 150))
    return paint


def street_clutter(seed: int, season: str, number: int) -> Paint:
    """A bin, box, bench, planter or hydrant, 1.2 x 1.2 m."""
    rng = generator(seed, "clutter", number)
    paint = Paint(1.2, 1.2, texels=44)
    kind = int(rng.integers(5))
    tone = pick(rng, SIGNS)
    if kind == 0:
        paint.polygon([(0.3, 0), (0.22, 1.0), (0.9, 1.0), (0.82, 0)], tone)
        paint.box(0.18, 0.98, 0.95, 1.08, dim(tone, 0.6))
    elif kind == 1:
        paint.box(0.15, 0, 1.05, 1.15, vary(rng, (125, 135, 130), 15))
        paint.line(0.6, 0, 0.6, 1.15, 0.03, (70, 75, 72))
    elif kind == 2:
        for y in (0.42, 0.6, 0.78):
            paint.box(0.02, y, 1.18, y + 0.1, vary(rng, (60, 90, 120), 12))
        for x in (0.1, 1.0):
            paint.box(x, 0, x + 0.08, 0.85, BLACK)
    elif kind == 3:
        paint.box(0.2, 0, 1.0, 0.5, vary(rng, (120, 130, 150), 15))
        for _ in range(90):
            leaf = (60, 110, 70) if season != "winter" else (90, 110, 120)
            x, y = rng.normal(0.6, 0.2), rng.uniform(0.45, 1.1)
            paint.disk(x, y, 0.07, 0.06, vary(rng, leaf, 25))
    else:
        paint.box(0.45, 0, 0.75, 0.8, (40, 40, 180))
        paint.disk(0.6, 0.8, 0.17, 0.15, (40, 40, 170))
    if season == "winter" and kind < 3:
        low, high = (1.05, 1.12) if kind < 2 else (0.5, 0.56)
        paint.box(0.15, low, 1.0, high, SNOW)
    paint.shade(np.linspace(0.6, -1, paint.columns, dtype=np.float32)[None, :], 0.15)
    return paint


def wire(seed: int, season: str, number: int) -> Paint:
    """A line that hangs between two poles, 24 x 1.2 m."""
    paint = Paint(24, 1.2, texels=22)
    x = np.linspace(0, 24, 60)
    y = 0.15 + 1.0 * ((x - 12) / 12) ** 2
    points = np.array([paint.at(a, b) for a, b in zip(x, y, strict=True)], np.int32)
    cv2.polylines(paint.alpha, [points], False, 255, 1, cv2.LINE_AA)
    paint.colour[:] = 35
    return paint
