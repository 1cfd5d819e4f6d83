"""All textures by name, and their halved copies, so that far things neither flicker nor alias."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.worlds import corridor, facades, land, plants, things
from amusic_gym.worlds.layout import Key
from amusic_gym.worlds.paint import Paint

LEVELS = 7  # halved copies of a texture, at most
Levels = tuple[NDArray[np.uint8], NDArray[np.int64]]  # pixels, flat; (start, width, height) each

MAKERS: dict[str, Callable[..., Paint]] = {
    "facade": facades.facade,
    "side": facades.side,
    "gable": facades.gable,
    "roof": facades.roof,
    "tree": plants.tree,
    "bush": plants.bush,
    "grass": plants.grass,
    "thicket": plants.thicket,
    "wire": things.wire,
    "pole": things.pole,
    "lamp": things.lamp_head,
    "sign": things.sign,
    "board": things.board,
    "fence": things.fence,
    "low_wall": things.low_wall,
    "clutter": things.street_clutter,
    "car_side": things.car_side,
    "car_back": things.car_back,
    "train": things.train,
    "person": things.person,
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
}
"""Each takes the world's seed, the season and the rest of its key."""


def texture(seed: int, key: Key, season: str) -> Levels:
    """All levels of a texture of a world."""
    maker, *arguments = key
    return pyramid(MAKERS[str(maker)](seed, season, *arguments).image())


def pyramid(texture: NDArray[np.uint8]) -> Levels:
    """All halved copies of a texture in one flat array, and where each begins.

    Args:
        texture: (H, W, 5) uint8: blue, green, red, alpha, glow; colours *not* yet times alpha.
    """
    alpha = texture[..., 3:4]
    colours = cv2.multiply(texture[..., :3], cv2.merge([alpha] * 3), scale=1 / 255)
    level = cv2.merge([*cv2.split(colours), texture[..., 3]])
    glow = cv2.multiply(texture[..., 4], texture[..., 3], scale=1 / 255)
    parts, table, start = [], [], 0
    for _ in range(LEVELS):
        height, width = glow.shape
        # Order in memory: blue, green, red, alpha, glow.
        parts.append(np.dstack([level, glow]).reshape(-1))
        table.append((start, width, height))
        start += parts[-1].size
        if min(height, width) < 4:
            break
        half = (width // 2, height // 2)
        level = cv2.resize(level, half, interpolation=cv2.INTER_AREA)
        glow = cv2.resize(glow, half, interpolation=cv2.INTER_AREA)
    return np.concatenate(parts), np.array(table, np.int64)
