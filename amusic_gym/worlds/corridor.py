"""Corridors: doors, glass, posters, lockers, alcoves and cross passages."""

import numpy as np

from amusic_gym.worlds import ground
from amusic_gym.worlds.facades import SIGNS, lettering
from amusic_gym.worlds.ground import BLOCK, GroundPlan
from amusic_gym.worlds.layout import Block
from amusic_gym.worlds.noise import Generator, generator, patch
from amusic_gym.worlds.paint import Colour, Paint, dim, pick, vary

SPACING = 0.8
EYE = 1.35
SWAY = 0.55
BENDS = ((1.2, 95.0), (0.35, 47.0))

HIGH = 2.9
WALLS = ((205, 210, 212), (190, 205, 215), (185, 195, 180), (170, 150, 60), (150, 165, 120),
         (120, 150, 190), (175, 180, 185))  # fmt: skip
DOORS = ((140, 150, 60), (60, 90, 140), (90, 100, 110), (150, 90, 40), (60, 70, 160), (45, 60, 80),
         (190, 195, 195))  # fmt: skip
BAYS = ("wall", "door", "door", "glass", "lockers", "wall", "double")
SWITCHES = ((220, 222, 225), (60, 60, 190), (70, 150, 60), (80, 80, 80))


def half_width(seed: int, block: int) -> float:
    """Half the corridor's width; it changes now and then."""
    return float(generator(seed, "width", block // 3).choice([1.1, 1.35, 1.7, 2.3]))


def plan(seed: int, number: int, season: str) -> GroundPlan:
    """The floor of a block."""
    return ground.floor(seed, number)


def build(seed: int, number: int) -> Block:
    """Block ``number`` of a corridor."""
    block = Block(seed, number * BLOCK)
    half = half_width(seed, number)
    before = half_width(seed, number - 1)
    if before > half:
        for side in (-1, 1):
            a, b = sorted((side * half, side * before))
            block.front(a, b, 0, HIGH, ("plain", number, b - a, HIGH))
    for side in (-1, 1):
        rng = block.draw("corridor", number, side)
        s = 0.0
        while s < BLOCK - 0.05:
            long = min(float(rng.choice([2.0, 3.0, 4.0])), BLOCK - s)
            bay(block, rng, side, half, s, long)
            s += long
        clutter(block, rng, side, half)
    rng = block.draw("overhead", number)
    for _ in range(int(rng.poisson(1.0))):
        s, board = rng.uniform(1, BLOCK - 1), ("board", int(rng.integers(60)), 1.2, 0.35, 160)
        block.plane((-0.6, HIGH - 0.45, s), (1.2, 0, 0), (0, 0.35, 0), board)
    if rng.random() < 0.3:  # a door frame across
        frame(block, half, rng.uniform(2, BLOCK - 2))
    for s in (3.0, 11.0, 19.0):
        block.lamps.append((0.0, HIGH - 0.2, s))
    return block


def bay(block: Block, rng: Generator, side: int, half: float, s: float, long: float) -> None:
    """A few metres of wall: plain, doors, glass, lockers, or an opening."""
    what, stretch = rng.random(), block.number // 3
    identity = block.number * 100 + int(s * 4) + (50 if side > 0 else 0)
    if block.draw("bays", stretch).random() < 0.4:  # bays repeat
        identity = int(rng.integers(6))
    x, kind = side * half, "wall"
    if what < 0.12 and long >= 2:  # a cross passage or alcove
        deep = float(rng.choice([0.8, 1.5, 6.0]))
        x += side * deep
        block.front(side * half, x, s + long, HIGH, ("plain", identity, deep, HIGH, stretch))
    elif what < 0.2:  # a pillar or shaft that stands out
        x -= side * 0.3
        block.front(side * half, x, s, HIGH, ("plain", identity, 0.3, HIGH, stretch))
    else:
        kind = BAYS[int(rng.integers(len(BAYS)))]
    block.wall(x, s, s + long, HIGH, ("bay", identity, stretch, long, kind))


def frame(block: Block, half: float, s: float) -> None:
    """A fire door standing open: posts and a lintel across the corridor."""
    number, stretch = block.number, block.number // 3
    for a, b in ((-half, -half + 0.3), (half - 0.3, half)):
        block.front(a, b, s, HIGH, ("plain", number, 0.3, HIGH, stretch))
    lintel = ("plain", number, 2 * half, 0.6, stretch)
    block.front(-half, half, s, 0.6, lintel, base=HIGH - 0.6)
    block.wall(half - 0.25, s + 0.1, s + 1.1, 2.1, ("bay", number, stretch, 1.0, "door"))


def clutter(block: Block, rng: Generator, side: int, half: float) -> None:
    """Things along the wall."""
    for _ in range(int(rng.poisson(3.0))):
        s, what = rng.uniform(0, BLOCK - 1.5), int(rng.integers(6))
        x = side * (half - 0.25)
        if what == 0:
            high, x = float(rng.choice([0.9, 1.4, 1.9])), side * (half - 0.45)
            block.wall(x, s, s + 1.2, high, ("cabinet", int(rng.integers(20)), 1.2, high))
            block.front(side * half, x, s, high, ("cabinet", int(rng.integers(20)), 0.45, high))
        elif what == 1:
            block.sprite(x, s, 0.7, 1.5, ("plant", int(rng.integers(8))), reach=40)
        elif what == 2:
            block.sprite(x, s, 0.8, 0.9, ("chair", int(rng.integers(10))), reach=40)
        elif what == 3:
            block.sprite(x, s, 0.35, 0.7, ("bin", int(rng.integers(10))), reach=40)
        else:
            wide = float(rng.choice([0.6, 1.0, 1.8]))
            poster = ("board", int(rng.integers(60)), wide, 0.8, 0)
            block.wall(side * (half - 0.02), s, s + wide, 0.8, poster, base=1.3)


def moving(seed: int, run: int, frame: int, start: float, amount: float) -> Block:
    """People around a camera at ``start``."""
    block = Block(seed, start)
    rng = generator(seed, "moving", run, frame)
    for _ in range(int(rng.poisson(4.5 * amount))):
        x, s, key = rng.uniform(-1, 1), rng.uniform(1.4, 14), ("person", int(rng.integers(40)))
        block.sprite(x, s, 0.9, 1.9, key, reach=60)
    return block


def bay_paint(seed: int, season: str, number: int, stretch: int, long: float, kind: str) -> Paint:
    """The face of a bay ``long`` metres long."""
    look = generator(seed, "walls", stretch)
    rng = generator(seed, "bay", number)
    wall, door = pick(look, WALLS), pick(look, DOORS)
    lower, rail_height = pick(look, WALLS), float(look.choice([0.0, 0.9, 1.2]))
    paint = Paint(long, HIGH, wall, texels=44)
    if look.random() < 0.25:
        for x in np.arange(0, long, 0.4):
            paint.box(x, 0, x + 0.02, HIGH, vary(rng, wall, 6))
        for y in np.arange(0, HIGH, 0.2):
            paint.box(0, y, long, y + 0.02, dim(wall, 0.85))
    if rail_height:
        paint.box(0, 0, long, rail_height, lower)
        paint.box(0, rail_height, long, rail_height + 0.1, dim(lower, 0.6))
    FACES[kind](paint, rng, long, door)
    paint.box(0, 0, long, 0.11, vary(look, (60, 62, 65), 25))
    for _ in range(int(rng.integers(0, 4))):  # switches, sockets, detectors, exit signs
        x, y = rng.uniform(0.1, long - 0.2), rng.choice([0.3, 1.1, 2.3, 2.6])
        size = rng.uniform(0.06, 0.2)
        paint.box(x, y, x + size, y + size, pick(rng, SWITCHES))
    if rng.random() < 0.3:
        x = rng.uniform(0.1, long - 0.3)
        paint.disk(x + 0.1, 1.1, 0.09, 0.28, (35, 35, 190))
        paint.box(x - 0.05, 1.6, x + 0.25, 1.9, (40, 40, 200))
    paint.weather(rng, 0.02, 0.05)
    ramp = np.cos(np.linspace(-1.2, 1.35, paint.rows, dtype=np.float32))[:, None] - 0.75
    paint.shade(np.repeat(ramp, paint.columns, 1), 0.28)
    return paint


def _door(paint: Paint, rng: Generator, long: float, door: Colour, x: float | None = None) -> None:
    x = rng.uniform(0.15, max(0.16, long - 1.15)) if x is None else x
    wide = min(0.95, long - 0.1)
    edge = vary(rng, (150, 155, 160), 40)
    paint.box(x - 0.08, 0, x + wide + 0.08, 2.18, edge)
    paint.box(x, 0, x + wide, 2.1, door)
    if rng.random() < 0.5:
        paint.box(x + 0.6 * wide, 1.1, x + 0.8 * wide, 1.9, (65, 60, 55))
    if rng.random() < 0.5:
        paint.box(x + 0.2 * wide, 1.5, x + 0.5 * wide, 1.75, (225, 225, 225))
        lettering(paint, rng, x + 0.22 * wide, 1.55, 0.25, 0.1, (225, 225, 225))
    paint.box(x + 0.06, 1.0, x + 0.2, 1.05, (190, 190, 190))
    paint.box(x, 0.0, x + wide, 0.2, dim(door, 0.8))


def _double(paint: Paint, rng: Generator, long: float, door: Colour) -> None:
    _door(paint, rng, long, door, 0.1)
    if long >= 2.2:
        _door(paint, rng, long, door, 1.12)


def _glass(paint: Paint, rng: Generator, long: float, door: Colour) -> None:
    """A window into a room with things in it, or to the outside."""
    low = float(rng.choice([0.15, 0.9]))
    paint.box(0.15, low, long - 0.15, 2.4, door)
    outside = rng.random() < 0.35
    tint: Colour = (235, 225, 210) if outside else vary(rng, (120, 125, 125), 30)
    paint.box(0.22, low + 0.07, long - 0.22, 2.33, tint, 200 if outside else 60)
    if outside:
        for _ in range(40):
            x, y = rng.uniform(0.25, long - 0.25), rng.uniform(low + 0.1, 1.6)
            paint.disk(x, y, 0.12, 0.1, vary(rng, (70, 120, 90), 30), 120)
    else:
        for _ in range(int(rng.integers(6, 16))):
            x, y = rng.uniform(0.25, long - 0.6), rng.uniform(low + 0.08, 1.9)
            end = min(long - 0.25, x + rng.uniform(0.1, 0.6))
            top = min(2.3, y + rng.uniform(0.05, 0.6))
            paint.box(x, y, end, top, pick(rng, (*SIGNS, (150, 150, 150), (60, 60, 60))))
    for x in np.arange(0.22, long - 0.2, float(rng.choice([0.8, 1.2]))):
        paint.box(x - 0.03, low, x + 0.03, 2.4, door)


def _lockers(paint: Paint, rng: Generator, long: float, door: Colour) -> None:
    high = float(rng.choice([1.8, 2.1]))
    for x in np.arange(0.05, long - 0.3, 0.38):
        paint.box(x, 0.1, x + 0.36, high, vary(rng, door, 7))
        paint.box(x + 0.36, 0.1, x + 0.38, high, (40, 42, 45))
        for y in (high - 0.25, high - 0.33):
            paint.box(x + 0.1, y, x + 0.26, y + 0.03, (50, 52, 55))
        paint.box(x + 0.3, 1.0, x + 0.33, 1.1, (190, 190, 190))


def _pictures(paint: Paint, rng: Generator, long: float, door: Colour) -> None:
    for _ in range(int(rng.integers(0, 5))):
        x, wide = rng.uniform(0.05, max(0.06, long - 0.9)), rng.uniform(0.25, 0.8)
        y, high = rng.uniform(1.0, 1.6), rng.uniform(0.3, 0.8)
        sheet = pick(rng, ((225, 225, 225), *SIGNS))
        paint.box(x - 0.03, y - 0.03, x + wide + 0.03, y + high + 0.03, (60, 62, 62))
        paint.box(x, y, x + wide, y + high, sheet)
        for row in range(int(rng.integers(2, 6))):
            level = y + high * (0.1 + 0.14 * row)
            lettering(paint, rng, x + 0.03, level, wide - 0.06, 0.1 * high, sheet)
        if rng.random() < 0.6:
            left, right = x + 0.1 * wide, x + 0.9 * wide
            paint.box(left, y + 0.55 * high, right, y + 0.9 * high, pick(rng, SIGNS))


FACES = {
    "wall": _pictures, "door": _door, "double": _double, "glass": _glass, "lockers": _lockers,
}  # fmt: skip
"""What is on a bay's wall, by its kind."""


def plain_paint(
    seed: int, season: str, number: int, wide: float, high: float, stretch: int = 0
) -> Paint:
    """A bare piece of wall."""
    wall = pick(generator(seed, "walls", stretch), WALLS)
    tone = vary(generator(seed, "plain", number), wall, 8)
    paint = Paint(max(0.1, wide), high, tone, texels=30)
    paint.shade(patch(generator(seed, "plain", number), paint.rows, paint.columns, 1.0), 0.05)
    return paint
