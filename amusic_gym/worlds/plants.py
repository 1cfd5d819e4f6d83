"""Trees, bushes, hedges and grass with leaves and branches at several scales."""

import math
from functools import lru_cache

import cv2
import numpy as np

from amusic_gym.worlds.noise import Generator, generator, patch
from amusic_gym.worlds.paint import Colour, Paint, vary

GREENS = ((35, 85, 60), (30, 70, 50), (45, 105, 85), (40, 95, 60), (30, 75, 70))
AUTUMN = ((30, 110, 190), (30, 80, 170), (40, 150, 200), (30, 60, 130), (45, 110, 120))
BARK = ((45, 55, 65), (60, 70, 80), (35, 40, 48))
SNOW = (235, 232, 228)
TREES: tuple[tuple[float, str], ...] = (
    (5, "broad"), (8, "broad"), (8, "broad"), (11, "broad"), (11, "broad"), (6, "slim"),
    (9, "slim"), (11, "slim"), (7, "conifer"), (9, "conifer"), (12, "conifer"),
)  # fmt: skip
"""Height in metres and kind of the trees that a world has; each stands in many places."""


def _branch(
    paint: Paint, rng: Generator, x: float, y: float, angle: float, length: float, wide: float,
    depth: int, tips: list[tuple[float, float, float]], bark: Colour,
) -> None:  # fmt: skip
    x1, y1 = x + length * math.sin(angle), y + length * math.cos(angle)
    paint.line(x, y, x1, y1, wide, vary(rng, bark, 8))
    tips.append((x1, y1, length))
    if depth == 0:
        return
    for _ in range(int(rng.integers(2, 4))):
        turn = rng.normal(0, 0.55)
        _branch(paint, rng, x1, y1, angle * 0.8 + turn, length * rng.uniform(0.6, 0.82),
                wide * 0.62, depth - 1, tips, bark)  # fmt: skip


def leaf_colour(rng: Generator, season: str, seed_colour: int) -> Colour:
    """The colour of a plant's leaves in a season."""
    table = AUTUMN if season == "autumn" else GREENS
    return vary(rng, table[seed_colour % len(table)], 9)


def _foliage(
    paint: Paint, rng: Generator, clumps: list[tuple[float, float, float]], colour: Colour,
    count: int, leaf: float,
) -> None:  # fmt: skip
    """Leaves in clumps, dark below and bright above: drawn from the back to the front."""
    order = rng.permutation(len(clumps))
    per = max(4, count // max(1, len(clumps)))
    both = np.dstack([paint.colour, paint.alpha])  # one drawing call for both
    for x, y, size in (clumps[index] for index in order):
        offsets = rng.normal(0, 0.42 * size, (per, 2))
        offsets = offsets[np.argsort(offsets[:, 1] + rng.normal(0, 0.3 * size, per))]
        tone = 0.62 + 0.55 * (offsets[:, 1] / size + 0.5) + rng.normal(0, 0.16, per)
        tints = np.clip(tone, 0.25, 1.6)[:, None] * np.asarray(colour)
        sizes = leaf * rng.uniform(0.5, 1.5, (per, 1)) * (1.0, 0.6) * paint.texels
        axes = np.maximum(1, np.rint(sizes)).astype(int).tolist()
        columns = np.rint((x + offsets[:, 0]) * paint.texels).astype(int).tolist()
        rows = np.rint(paint.rows - (y + offsets[:, 1]) * paint.texels).astype(int).tolist()
        turns = (60 * offsets[:, 0]).tolist()
        for leaf_at in zip(columns, rows, axes, turns, tints.tolist(), strict=True):
            column, row, axis, turn, tint = leaf_at
            cv2.ellipse(both, (column, row), axis, turn, 0, 360, (*tint, 255), -1)
    paint.colour[:], paint.alpha[:] = both[..., :3], both[..., 3]


@lru_cache(maxsize=64)
def tree(seed: int, season: str, number: int) -> Paint:
    """One of `TREES`."""
    rng = generator(seed, "tree", number)
    high, kind = TREES[number]
    texels = min(26.0, 190 / high)
    if kind == "conifer":
        return _conifer(rng, season, high, texels)
    wide = high * (0.55 if kind == "slim" else 0.95)
    paint = Paint(wide, high, texels=texels)
    bark = (185.0, 190.0, 190.0) if kind == "slim" else BARK[number % 3]
    tips: list[tuple[float, float, float]] = []
    trunk = high * rng.uniform(0.2, 0.3)
    _branch(paint, rng, wide / 2, 0, rng.normal(0, 0.05), trunk, high * 0.04, 4, tips, bark)
    tips = [(float(np.clip(x, 0.12 * wide, 0.88 * wide)), min(y, high * 0.88), length)
            for x, y, length in tips[1:]]  # fmt: skip
    if season == "winter":
        for x, y, length in tips[::2]:
            paint.line(x, y, x + rng.normal(0, 0.3) * length, y + 0.3 * length, 0.05, SNOW)
    else:
        share = 0.55 if season == "autumn" else 1.0
        colour = leaf_colour(rng, season, number)
        _foliage(paint, rng, tips, colour, int(1300 * share), high * 0.028)
    paint.shade(patch(rng, paint.rows, paint.columns, 0.7), 0.1)
    return paint


def _conifer(rng: Generator, season: str, high: float, texels: float) -> Paint:
    wide = high * rng.uniform(0.32, 0.48)
    paint = Paint(wide, high, texels=texels)
    paint.line(wide / 2, 0, wide / 2, high * 0.9, high * 0.025, BARK[0])
    colour = vary(rng, (38, 62, 40), 8)
    for y in np.arange(0.08, 0.99, 0.022):
        reach = 0.5 * wide * (1 - y) ** 0.8 * rng.uniform(0.65, 1.0)
        for _ in range(max(3, int(18 * (1 - y)))):
            dx = rng.uniform(-reach, reach)
            shade = 0.55 + 0.5 * rng.random() - 0.25 * abs(dx) / max(reach, 0.01) * (dx > 0)
            snowy = season == "winter" and rng.random() < 0.35
            tint = SNOW if snowy else (colour[0] * shade, colour[1] * shade, colour[2] * shade)
            x, h = wide / 2 + dx, y * high
            droop = 0.25 * abs(dx)
            paint.line(x - 0.15 * np.sign(dx), h - droop + 0.08, x + 0.12 * np.sign(dx),
                       h - droop - 0.12, 0.1 * high / 10, tint)  # fmt: skip
    return paint


def bush(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """A bush or a stretch of hedge, ``wide`` x ``high`` metres."""
    rng = generator(seed, "bush", number)
    paint = Paint(wide, high, texels=min(30.0, 160 / max(wide, high)))
    steps = max(3, int(wide / 0.35))
    clumps = []
    for i in range(2 * steps):
        x = wide * (0.08 + 0.84 * (i // 2 + rng.random()) / steps)
        clumps.append((x, high * rng.uniform(0.15, 0.68), 0.38 * high))
    if season == "winter":
        for x, y, size in clumps * 4:
            end = x + rng.normal(0, 0.25)
            paint.line(x, 0.05, end, y + size * rng.random(), 0.03, BARK[number % 3])
        _foliage(paint, rng, [(x, y, 0.6 * s) for x, y, s in clumps], SNOW, 60, 0.05)
        return paint
    colour = leaf_colour(rng, season, number)
    _foliage(paint, rng, clumps, colour, int(120 + 160 * wide), 0.055 + 0.02 * high)
    paint.shade(np.linspace(0.25, -1, paint.rows, dtype=np.float32)[:, None], 0.3)
    return paint


def grass(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """Tall grass and weeds along a verge."""
    rng = generator(seed, "grass", number)
    paint = Paint(wide, high, texels=36)
    seasons: dict[str, Colour] = {
        "summer": (50, 115, 90), "autumn": (75, 120, 130), "winter": (150, 165, 175)
    }  # fmt: skip
    for _ in range(int(70 * wide)):
        x = rng.uniform(0, wide)
        end, top = x + rng.normal(0, 0.12), high * rng.uniform(0.3, 1.0)
        paint.line(x, 0, end, top, 0.025, vary(rng, seasons[season], 22))
    return paint


def thicket(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """A wall of trees and bushes: their pictures side by side."""
    rng = generator(seed, "thicket", number)
    paint = Paint(wide, high, texels=16)
    for _ in range(int(2.2 * wide)):
        part = tree(seed, season, int(rng.integers(len(TREES))))
        tall = rng.uniform(0.45, 1.0) * paint.rows
        size = (max(2, int(tall * part.columns / part.rows)), int(tall))
        both = np.dstack([part.colour, part.alpha])
        picture = cv2.resize(both, size, interpolation=cv2.INTER_AREA)
        x = int(rng.integers(-size[0] // 2, paint.columns - size[0] // 2))
        left, right = max(0, x), min(paint.columns, x + size[0])
        target = (slice(paint.rows - size[1], paint.rows), slice(left, right))
        piece = picture[:, left - x : right - x]
        alpha = piece[..., 3:].astype(np.float32) / 255
        mixed = paint.colour[target] * (1 - alpha) + piece[..., :3] * alpha * rng.uniform(0.6, 1.05)
        paint.colour[target] = np.clip(mixed, 0, 255)
        paint.alpha[target] = np.maximum(paint.alpha[target], piece[..., 3])
    return paint
