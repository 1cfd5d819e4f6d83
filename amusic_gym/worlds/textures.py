"""All textures by name: made when first needed, kept while they are used."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from amusic_gym.worlds import corridor, facades, land, plants, roofs, things
from amusic_gym.worlds.layout import Key
from amusic_gym.worlds.levels import Levels, pyramid
from amusic_gym.worlds.noise import generator
from amusic_gym.worlds.paint import Paint
from amusic_gym.worlds.street import TREES

KEPT = 400
"""Textures kept in memory, about 0.3 MB each."""


def _facade(
    seed: int, season: str, number: int, style: int, wide: float, storeys: int, use: str
) -> Paint:
    kind = facades.style_of(seed, style)
    return facades.facade(seed, number, kind, wide, storeys, use, season)


def _side(seed: int, season: str, number: int, style: int, deep: float, high: float) -> Paint:
    return roofs.blank_side(seed, number, facades.style_of(seed, style), deep, high)


def _gable(seed: int, season: str, number: int, style: int, deep: float, rise: float) -> Paint:
    paint = _side(seed, season, number, style, deep, rise)
    cover = np.zeros_like(paint.alpha)
    corners = np.array([[0, paint.rows], [paint.columns, paint.rows], [paint.columns // 2, 0]])
    cv2.fillPoly(cover, [corners.astype(np.int32)], 255)
    paint.alpha &= cover
    return paint


@lru_cache(maxsize=64)
def _tree(seed: int, season: str, number: int, high: float, kind: str) -> Paint:
    return plants.tree(seed, number, season, high, kind)


def _thicket(seed: int, season: str, number: int, wide: float, high: float) -> Paint:
    """A wall of trees and bushes: their pictures side by side."""
    rng = generator(seed, "thicket", number)
    paint = Paint(wide, high, texels=16)
    for _ in range(int(2.2 * wide)):
        index = int(rng.integers(len(TREES)))
        part = _tree(seed, season, index, *TREES[index])
        tall = rng.uniform(0.45, 1.0) * paint.rows
        size = (max(2, int(tall * part.columns / part.rows)), int(tall))
        picture = cv2.resize(
            np.dstack([part.colour, part.alpha]), size, interpolation=cv2.INTER_AREA
        )
        x = int(rng.integers(-size[0] // 2, paint.columns - size[0] // 2))
        left, right = max(0, x), min(paint.columns, x + size[0])
        target = (slice(paint.rows - size[1], paint.rows), slice(left, right))
        piece = picture[:, left - x : right - x]
        alpha = piece[..., 3:].astype(np.float32) / 255
        mixed = paint.colour[target] * (1 - alpha) + piece[..., :3] * alpha * rng.uniform(0.6, 1.05)
        paint.colour[target] = np.clip(mixed, 0, 255)
        paint.alpha[target] = np.maximum(paint.alpha[target], piece[..., 3])
    return paint


def _wire(seed: int, season: str, number: int) -> Paint:
    paint = Paint(24, 1.2, texels=22)
    x = np.linspace(0, 24, 60)
    y = 0.15 + 1.0 * ((x - 12) / 12) ** 2
    points = np.array([paint.at(a, b) for a, b in zip(x, y, strict=True)], np.int32)
    cv2.polylines(paint.alpha, [points], False, 255, 1, cv2.LINE_AA)
    paint.colour[:] = 35
    return paint


MAKERS: dict[str, Callable[..., Paint]] = {
    "facade": _facade,
    "side": _side,
    "gable": _gable,
    "roof": lambda seed, season, number, wide, deep: roofs.roof(seed, number, wide, deep, season),
    "tree": _tree,
    "bush": lambda seed, season, number, wide, high: plants.bush(seed, number, season, wide, high),
    "hedge": lambda seed, season, number, wide, high: plants.bush(
        seed, number + 90, season, wide, high
    ),
    "grass": lambda seed, season, number, wide, high: plants.grass(
        seed, number, season, wide, high
    ),
    "thicket": _thicket,
    "wire": _wire,
    "pole": lambda seed, season, number, high, wide: things.pole(seed, number, high, wide),
    "lamp": lambda seed, season, number: things.lamp_head(seed, number),
    "sign": lambda seed, season, number: things.sign(seed, number),
    "board": lambda seed, season, number, wide, high, glow: things.board(
        seed, number, wide, high, glow
    ),
    "fence": lambda seed, season, number, wide, high: things.fence(seed, number, wide, high),
    "low_wall": lambda seed, season, number, wide, high: things.low_wall(
        seed, number, wide, high, season
    ),
    "clutter": lambda seed, season, number: things.street_clutter(seed, number, season),
    "car_side": lambda seed, season, number: things.car_side(seed, number, season),
    "car_back": lambda seed, season, number: things.car_back(seed, number, season),
    "bay": corridor.bay_paint,
    "plain": corridor.plain_paint,
    "rock": land.rock,
    "slope": land.slope,
    "platform": land.platform,
    "paving": land.paving,
    "masonry": land.masonry,
    "cabinet": land.cabinet,
    "plant": land.pot_plant,
    "chair": land.chair,
    "bin": land.bin_,
    "train": lambda seed, season, number: things.train(seed, number),
    "person": lambda seed, season, number: things.person(seed, number, season),
}
"""Each takes the world's seed, the season and the rest of its key."""


class Textures:
    """The textures of one world."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._kept: OrderedDict[Any, Levels] = OrderedDict()

    def get(self, key: Key, season: str) -> Levels:
        """All levels of a texture and the table of them (see `levels.pyramid`)."""
        full = (key, season)
        levels = self._kept.get(full)
        if levels is None:
            maker, *arguments = key
            paint = MAKERS[str(maker)](self.seed, season, *arguments)
            levels = pyramid(paint.image())
            self._kept[full] = levels
            if len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        else:
            self._kept.move_to_end(full)
        return levels
