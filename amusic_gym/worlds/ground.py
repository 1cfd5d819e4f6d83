"""Maps of the ground (and of ceilings) seen from above, one block of the route at a time."""

from collections.abc import Iterable
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.worlds.noise import Floats, Generator, fractal, generator, patch
from amusic_gym.worlds.paint import Colour

ALONG = 10  # texels per metre along the route
ACROSS = 14  # texels per metre across it
HALF = 22.0  # metres of ground to either side; beyond, the edge goes on
BLOCK = 24  # metres of route in a block
Texture = NDArray[np.uint8]


class GroundPlan:
    """A block's ground while it is painted; across from -HALF to HALF, along from 0 to BLOCK."""

    def __init__(self, rng: Generator, colour: Colour) -> None:
        self.rng = rng
        self.rows, self.columns = BLOCK * ALONG, int(2 * HALF * ACROSS)
        self.colour = np.empty((self.rows, self.columns, 3), np.float32)
        self.colour[:] = colour
        self.glow = np.zeros((self.rows, self.columns), np.uint8)

    def strip(self, x0: float, x1: float, colour: Colour, s0: float = 0, s1: float = BLOCK) -> None:
        """Fill a rectangle."""
        self.colour[self._rows(s0, s1), self._columns(x0, x1)] = colour

    def grain(
        self, x0: float, x1: float, strength: float, exponent: float = 0.8, zoom: float = 1.0
    ) -> None:
        """Roughen a strip."""
        part = self.colour[:, self._columns(x0, x1)]
        part *= 1 + strength * patch(self.rng, self.rows, part.shape[1], exponent, zoom)[..., None]

    def cover(self, x0: float, x1: float, colour: Colour, share: float, zoom: float = 1.0) -> None:
        """Patches of something over a strip, about ``share`` of it."""
        part = self.colour[:, self._columns(x0, x1)]
        field = patch(self.rng, self.rows, part.shape[1], 1.2, zoom)
        edge = np.clip((field + 2.6 * (share - 0.5)) * 3 + 0.5, 0, 1)[..., None]
        part[:] = part * (1 - edge) + np.asarray(colour) * edge

    def texture(self) -> Texture:
        """(rows, columns, 5) uint8 as `levels.pyramid` takes it."""
        full = np.full((self.rows, self.columns, 1), 255, np.uint8)
        colour = np.clip(self.colour, 0, 255).astype(np.uint8)
        return np.dstack([colour, full, self.glow[..., None]])

    def _rows(self, s0: float, s1: float) -> slice:
        return slice(max(0, round(s0 * ALONG)), max(0, round(s1 * ALONG)))

    def _columns(self, x0: float, x1: float) -> slice:
        return slice(max(0, round((x0 + HALF) * ACROSS)), max(0, round((x1 + HALF) * ACROSS)))


def shaded(texture: Texture, shadows: Iterable[NDArray[np.float64]], dark: float) -> Texture:
    """A copy of a map, darkened by ``dark`` (0-1) within the `Block.cast` shadows."""
    rows, columns = texture.shape[:2]
    mask = np.full((rows, columns), 255, np.uint8)
    for corners in shadows:
        points = (corners + (HALF, 0)) * (ACROSS, ALONG)
        cv2.fillPoly(mask, [np.rint(points).astype(np.int32)], 255 * (1 - dark))
    cv2.GaussianBlur(mask, (0, 0), 2.0, dst=mask)
    done = texture.copy()
    for channel in range(3):
        done[..., channel] = cv2.multiply(texture[..., channel], mask, scale=1 / 255)
    return done


GRASS = {"summer": (52, 112, 92), "autumn": (62, 108, 118), "winter": (228, 224, 220)}


def street(seed: int, block: int, zone: str, season: str, half: float, walk: float) -> GroundPlan:
    """Road of half width ``half`` with markings, repairs and kerbs, pavements, what lies beyond."""
    rng = generator(seed, "ground", block)
    look = generator(seed, "road", block // 6)
    snow = season == "winter"
    beyond = GRASS[season] if zone in ("suburb", "park") else (122, 126, 128)
    if snow:
        beyond = GRASS["winter"]
    plan = GroundPlan(rng, beyond)
    plan.grain(-HALF, HALF, 0.12)
    asphalt = look.uniform(70, 112)
    plan.strip(-half, half, (asphalt * 1.02, asphalt, asphalt * 0.98))
    for _ in range(int(rng.integers(0, 5))):  # repairs
        x, s = rng.uniform(-half, half - 1), rng.uniform(0, BLOCK - 3)
        tone = asphalt * rng.uniform(0.7, 1.2)
        end = min(half, x + rng.uniform(0.5, 2.5))
        plan.strip(x, end, (tone, tone, tone), s, s + rng.uniform(0.6, 6))
    plan.grain(-half, half, 0.1)
    paving = look.uniform(120, 165)
    for side in (-1, 1):
        a, b = sorted((side * half, side * (half + walk)))
        plan.strip(a, b, (paving, paving, paving * 0.98))
        for s in np.arange(0, BLOCK, 0.6):
            plan.strip(a, b, (paving * 0.8, paving * 0.8, paving * 0.78), s, s + 0.1)
        plan.grain(a, b, 0.1)
        edge = side * half
        plan.strip(edge - 0.12, edge + 0.12, (168, 170, 172))
    _markings(plan, rng, look, half)
    if zone == "suburb":
        for _ in range(2):
            side, s = rng.choice([-1, 1]), rng.uniform(1, BLOCK - 5)
            a, b = sorted((side * half, side * 14))
            plan.strip(a, b, (140, 142, 146), s, s + 2.8)
    if season == "autumn":
        leaves(plan, rng, half, 900)
    if snow:
        _snow(plan, half, walk)
    return plan


def _markings(plan: GroundPlan, rng: Generator, look: Generator, half: float) -> None:
    white = (205.0, 208.0, 208.0)
    style = int(look.integers(4))
    if style in (0, 1):
        for s in np.arange(0, BLOCK, 6.0 if style else 4.0):
            plan.strip(-0.07, 0.07, white, s, s + (3.0 if style else 2.0))
    elif style == 2:
        plan.strip(-0.07, 0.07, white)
    if look.random() < 0.5:
        for edge in (-half + 2.0, half - 2.0):
            for s in np.arange(0, BLOCK, 1.5):
                plan.strip(edge - 0.05, edge + 0.05, white, s, s + 0.7)
    if rng.random() < 0.22:  # a crossing
        s = rng.uniform(2, BLOCK - 5)
        for x in np.arange(-half + 0.3, half - 0.4, 1.0):
            plan.strip(x, x + 0.5, white, s, s + 3)
    for _ in range(int(rng.integers(0, 3))):
        x, s = rng.uniform(-half + 0.5, half - 1), rng.uniform(0, BLOCK - 1)
        plan.strip(x, x + 0.6, (60, 62, 65), s, s + 0.6)
    wear = patch(rng, plan.rows, plan.columns, 0.9)
    plan.colour *= (1 + 0.05 * wear)[..., None]


def leaves(plan: GroundPlan, rng: Generator, half: float, count: int) -> None:
    """Fallen leaves, thick at the kerbs."""
    x = np.where(rng.random(count) < 0.5, 1, -1) * np.abs(rng.normal(half, 1.8, count))
    s = rng.uniform(0, BLOCK, count)
    rows = np.clip(s * ALONG, 0, plan.rows - 1).astype(int)
    columns = np.clip((x + HALF) * ACROSS, 0, plan.columns - 2).astype(int)
    tints = np.array([[40, 120, 190], [35, 90, 160], [50, 150, 200], [40, 70, 120]])
    chosen = tints[rng.integers(4, size=count)] * rng.uniform(0.7, 1.1, (count, 1))
    plan.colour[rows, columns] = chosen
    plan.colour[rows, columns + 1] = chosen


def _snow(plan: GroundPlan, half: float, walk: float) -> None:
    plan.cover(-half - walk, -half, (232, 228, 226), 0.85, 2.0)
    plan.cover(half, half + walk, (232, 228, 226), 0.85, 2.0)
    plan.cover(-half, half, (215, 212, 210), 0.5, 2.5)
    for x in (-1.75, -0.75, 0.75, 1.75):  # wheel tracks
        plan.colour[:, plan._columns(x - 0.3 - 0.1, x + 0.3 + 0.1)] *= 0.8
    for side in (-1, 1):
        plan.cover(side * half - 0.6, side * half + 0.6, (238, 236, 234), 0.8)
    plan.grain(-HALF, HALF, 0.035, 1.0, 2.0)


def rail(seed: int, block: int, zone: str, season: str, tracks: int) -> GroundPlan:
    """Ballast, sleepers, a path beside the line and the land around it."""
    rng = generator(seed, "ground", block)
    snow = season == "winter"
    land = (205, 206, 206) if zone == "rock" and snow else GRASS[season]
    plan = GroundPlan(rng, land)
    plan.cover(-HALF, HALF, (70, 95, 105) if not snow else (190, 195, 198), 0.3, 2.0)
    plan.grain(-HALF, HALF, 0.14)
    right = 1.9 + 4.2 * (tracks - 1)
    plan.strip(-1.9, right, (98, 102, 108))
    plan.grain(-1.9, right, 0.22, 0.4)
    plan.strip(right, right + 1.4, (104, 116, 126))
    plan.grain(right, right + 1.4, 0.14, 0.6)
    for track in range(tracks):
        middle = 4.2 * track
        for s in np.arange(0, BLOCK, 0.65):
            tone = 105 + 14 * rng.normal()
            plan.strip(middle - 1.25, middle + 1.25, (tone * 0.92, tone, tone * 1.05), s, s + 0.26)
        for x in (-0.75, 0.75):
            plan.strip(middle + x - 0.16, middle + x + 0.16, (52, 62, 82))
    if snow:
        plan.cover(-2.4, right + 2.0, (226, 224, 222), 0.55, 1.5)
        for track in range(tracks):
            for x in (-0.75, 0.75):
                plan.strip(4.2 * track + x - 0.2, 4.2 * track + x + 0.2, (95, 100, 108))
        plan.grain(-HALF, HALF, 0.04, 1.1, 2.0)
    for track in range(tracks):
        for x in (-0.75, 0.75):
            plan.strip(4.2 * track + x - 0.04, 4.2 * track + x + 0.05, (178, 176, 174))
    return plan


def floor(seed: int, block: int) -> GroundPlan:
    """Lino, tiles, carpet or boards of a corridor."""
    look = generator(seed, "floor", block // 5)
    rng = generator(seed, "ground", block)
    tint = np.array([[115, 112, 108], [90, 105, 125], [130, 140, 150], [110, 95, 80], [80, 90, 85]])
    base = tint[int(look.integers(5))] * look.uniform(0.75, 1.2)
    plan = GroundPlan(rng, (float(base[0]), float(base[1]), float(base[2])))
    kind = int(look.integers(3))
    if kind == 0:
        size = float(look.choice([0.4, 0.6, 1.0]))
        for s in np.arange(0, BLOCK, size):
            plan.strip(-HALF, HALF, tuple(base * 0.8), s, s + 0.06)
        for x in np.arange(-6, 6, size):
            plan.strip(x, x + 0.06, tuple(base * 0.8))
    elif kind == 1:
        edge = look.uniform(0.4, 0.8)
        for side in (-1, 1):
            plan.strip(side * edge - 0.1, side * edge + 0.1, tuple(base * 0.6))
    plan.grain(-HALF, HALF, 0.06, 0.5)
    plan.grain(-HALF, HALF, 0.05, 1.2, 2.0)
    return plan


def ceiling(seed: int, block: int) -> GroundPlan:
    """Panels with light fittings and vents."""
    look = generator(seed, "ceiling", block // 5)
    rng = generator(seed, "ceiling", "block", block)
    tone = look.uniform(165, 215)
    plan = GroundPlan(rng, (tone * 0.98, tone, tone))
    size = float(look.choice([0.6, 1.2, 2.0]))
    for s in np.arange(0, BLOCK, size):
        plan.strip(-HALF, HALF, (tone * 0.8,) * 3, s, s + 0.06)
    for x in np.arange(-6, 6, size):
        plan.strip(x, x + 0.04, (tone * 0.8,) * 3)
    gap = float(look.choice([3.0, 4.0, 6.0]))
    long = bool(look.random() < 0.5)
    for s in np.arange(1.0, BLOCK, gap):
        if rng.random() < 0.9:
            x0, x1, s1 = (-0.15, 0.15, s + 1.4) if long else (-0.6, 0.6, s + 0.5)
            plan.strip(x0, x1, (250, 252, 252), s, s1)
            plan.glow[plan._rows(s, s1), plan._columns(x0, x1)] = 255
    for _ in range(int(rng.integers(0, 4))):
        x, s = rng.uniform(-1, 0.6), rng.uniform(0, BLOCK - 1)
        plan.strip(x, x + 0.4, (tone * 0.6,) * 3, s, s + 0.4)
    plan.grain(-HALF, HALF, 0.03, 1.0)
    return plan


@lru_cache(maxsize=1)
def detail() -> Floats:
    """(512, 512) grain around 1 that makes the nearest ground rough."""
    rough = 1 + 0.09 * fractal(0.5, 1) + 0.05 * fractal(1.0, 2)
    return np.ascontiguousarray(np.clip(rough, 0.6, 1.5), np.float32)


@lru_cache(maxsize=1)
def smooth_detail() -> Floats:
    """A quarter of it, for ceilings."""
    return np.ascontiguousarray(1 + 0.25 * (detail() - 1))
