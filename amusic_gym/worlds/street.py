"""Streets: terraces, shops, suburbs, parks, offices and works along a road, and its traffic."""

from collections.abc import Callable
from functools import partial

import numpy as np

from amusic_gym.worlds import ground
from amusic_gym.worlds.facades import style_of
from amusic_gym.worlds.ground import BLOCK, GroundPlan
from amusic_gym.worlds.layout import Block, Key, split, zone_of
from amusic_gym.worlds.noise import Generator, generator
from amusic_gym.worlds.plants import TREES

SPACING = 2.0
EYE = 1.6
SWAY = 1.0
BENDS = ((7.0, 330.0), (2.5, 170.0))

ZONES = ("terrace", "shops", "suburb", "park", "office", "works", "suburb", "terrace")
ZONE_BLOCKS = 3  # a zone stays so for as many blocks on average
STYLES = 9
ROAD = 3.6
WALK = 2.4
EDGE = ROAD + WALK


def plan(seed: int, number: int, season: str) -> GroundPlan:
    """The ground of a block."""
    zone = zone_of(seed, number, 1, ZONES, ZONE_BLOCKS)
    return ground.street(seed, number, zone, season, ROAD, WALK)


def build(seed: int, number: int) -> Block:
    """Block ``number`` of a street."""
    block = Block(seed, number * BLOCK)
    for side in (-1, 1):
        rng = block.draw("street", number, side)
        zone = zone_of(seed, number, side, ZONES, ZONE_BLOCKS)
        BUILDERS[zone](block, rng, side)
        furniture(block, rng, side, zone)
    rng = block.draw("lamps", number)
    side = int(block.draw("lampside", number // 8).choice([-1, 1]))
    lamp(block, side * (ROAD + 0.5), rng.uniform(1, 5), 6.0)
    lamp(block, -side * (ROAD + 0.5), 12 + rng.uniform(0, 5), 6.0)
    if block.draw("wires", number // 4).random() < 0.5:
        wires(block, -side)
    return block


def house(
    block: Block, x: float, s0: float, wide: float, storeys: int, number: int, style: int,
    use: str, deep: float = 9.0, gap: bool = False,
) -> None:  # fmt: skip
    """A house with its front at ``x``: front, side towards the camera, roof."""
    side = 1 if x > 0 else -1
    high = storeys * style_of(block.seed, style).storey + 0.7
    wide = round(wide, 2)
    block.wall(x, s0, s0 + wide, high, ("facade", number, style, wide, storeys, use))
    back = x + side * deep
    block.front(x, back, s0, high, ("side", number, style, deep, round(high, 2)), reach=110)
    if storeys <= 3 and use != "hall":
        rise = 2.6
        corner = (x - side * 0.3, high - 0.1, s0 + wide if side > 0 else s0)
        run = -wide if side > 0 else wide
        up = (side * deep / 2, rise, 0)
        block.plane(corner, (0, 0, run), up, ("roof", number, wide, 4.0), reach=120)
        gable = ("gable", number, style, deep, rise)
        block.front(x, back, s0, rise, gable, base=high - 0.1, reach=90)
        if number % 3 == 0 or gap:
            chimney = ("pole", number, 1.6, 0.8)
            block.sprite(x + side * 2.6, s0 + 0.7 * wide, 0.8, 1.6, chimney, high + 0.8)
    block.shadow(min(x, back), max(x, back), s0, s0 + wide, high)


def terrace(block: Block, rng: Generator, side: int, shops: bool = False) -> None:
    """Houses wall to wall; often one type repeats, now and then the very same house."""
    number = block.number
    shared = int(block.draw("row", side, number // 3).integers(STYLES))
    repeat = block.draw("repeat", side, number // 3).random() < 0.35
    x = side * EDGE
    s = 0.0
    parts = split(rng, int(rng.integers(2, 5))) if not repeat else [BLOCK / 4] * 4
    storeys = int(rng.integers(2, 5))
    for part, wide in enumerate(parts):
        style = shared if repeat or rng.random() < 0.45 else int(rng.integers(STYLES))
        if not repeat:
            storeys = int(np.clip(storeys + rng.integers(-1, 2), 2, 5))
        use = "shop" if shops or rng.random() < 0.12 else "home"
        identity = shared * 1000 + 7 if repeat else number * 10 + part + (5 if side > 0 else 0)
        back = 0.0 if rng.random() < 0.7 else rng.uniform(0.3, 1.5)
        house(block, x + side * back, s, wide, storeys, identity, style, use)
        s += wide


def office(block: Block, rng: Generator, side: int) -> None:
    """One large building with a forecourt."""
    style = int(rng.integers(STYLES))
    wide = rng.uniform(14, 21)
    s = rng.uniform(0.5, BLOCK - wide - 0.5)
    x = side * (EDGE + rng.uniform(1, 5))
    storeys = int(rng.integers(3, 7))
    house(block, x, s, wide, storeys, block.number * 10 + side, style, "home", 14)
    for _ in range(int(rng.integers(1, 4))):
        tree(block, rng, side * (EDGE + rng.uniform(0.2, 1.0)), rng.uniform(0, BLOCK), 4, 7)


def works(block: Block, rng: Generator, side: int) -> None:
    """A hall behind a wall or fence, hoardings."""
    number = block.number
    style = int(rng.integers(STYLES))
    wide = rng.uniform(12, 20)
    s = rng.uniform(0, BLOCK - wide)
    x = side * (EDGE + rng.uniform(3, 8))
    house(block, x, s, wide, int(rng.integers(1, 3)), number * 10 + side, style, "hall", 16)
    edge = side * (EDGE + 0.1)
    for part in range(3):
        kind = "low_wall" if rng.random() < 0.5 else "fence"
        key, s = (kind, number * 3 + part, 7.5, 1.9), part * 8.0
        block.wall(edge, s, s + 7.5, 1.9, key, reach=80)
    if rng.random() < 0.7:
        s = rng.uniform(0, 18)
        board = ("board", number + side, 4.0, 2.6, 0)
        block.wall(edge - side * 0.1, s, s + 4.0, 2.6, board, base=0.6)
    if rng.random() < 0.5:
        tree(block, rng, edge + side * 2, rng.uniform(0, BLOCK), 5, 9)


def park(block: Block, rng: Generator, side: int) -> None:
    """Trees and bushes at several depths, a fence or hedge in front."""
    for depth in (EDGE + 9, EDGE + 5, EDGE + 1.2):
        for _ in range(int(rng.integers(1, 5))):
            tree(block, rng, side * (depth + rng.uniform(-1, 2)), rng.uniform(0, BLOCK), 5, 12)
    for _ in range(int(rng.integers(2, 6))):
        shrub(block, rng, side * (EDGE + rng.uniform(0.6, 8)), rng.uniform(0, BLOCK), 1.2, 3.5)
    thicket = ("thicket", block.number % 5, 24.0, 6.0)
    block.wall(side * (EDGE + 15), 0, BLOCK, 6, thicket, reach=120)
    if rng.random() < 0.6:
        fence = ("fence", block.number // 4, 12.0, 1.1)
        block.wall(side * (EDGE + 0.2), 0, BLOCK, 1.1, fence, reach=60)


def suburb(block: Block, rng: Generator, side: int) -> None:
    """Detached houses in gardens."""
    number = block.number
    shared = int(block.draw("row", side, number // 4).integers(STYLES))
    count = int(rng.integers(1, 3))
    for part in range(count):
        wide = rng.uniform(7.5, 10)
        s = part * BLOCK / count + rng.uniform(0.5, max(0.6, BLOCK / count - wide - 0.5))
        style = shared if rng.random() < 0.6 else int(rng.integers(STYLES))
        x, storeys = side * (EDGE + rng.uniform(3, 6)), int(rng.integers(1, 3))
        house(block, x, s, wide, storeys, number * 10 + part + side, style, "home", 8, True)
    s = 0.0
    while s < BLOCK - 1:
        wide = min(rng.uniform(3, 8), BLOCK - s)
        kind = int(rng.integers(4))
        x, high = side * EDGE, 1.1
        key: Key
        if kind == 0:
            x, high = side * (EDGE + 0.5), round(rng.uniform(0.9, 2.2), 1)
            key = ("bush", int(rng.integers(12)) + 90, 6.0, high)
        elif kind == 1:
            high = 1.0
            key = ("low_wall", int(rng.integers(99)), 6.0, high)
        elif kind == 2:
            key = ("fence", int(rng.integers(99)), 6.0, high)
        if kind < 3:
            block.wall(x, s, s + wide, high, key, reach=70)
        s += wide + (0 if rng.random() < 0.5 else 2.8)
    for _ in range(int(rng.integers(2, 6))):
        tree(block, rng, side * (EDGE + rng.uniform(0.8, 4)), rng.uniform(0, BLOCK), 3, 8)
    for _ in range(int(rng.integers(2, 7))):
        shrub(block, rng, side * (EDGE + rng.uniform(0.5, 3)), rng.uniform(0, BLOCK), 0.8, 2.4)


BUILDERS: dict[str, Callable[[Block, Generator, int], None]] = {
    "terrace": terrace, "shops": partial(terrace, shops=True), "office": office,
    "works": works, "park": park, "suburb": suburb,
}  # fmt: skip


def tree(
    block: Block, rng: Generator, x: float, s: float, low: float, high: float, base: float = 0
) -> None:
    """A tree of about ``low`` to ``high`` metres, one of the world's."""
    number = int(rng.integers(len(TREES)))
    tall, kind = TREES[number]
    size = float(np.clip(rng.uniform(low, high) / tall, 0.6, 1.4))
    wide = {"broad": 0.95, "slim": 0.55, "conifer": 0.4}[kind] * tall * size
    block.sprite(x, s, wide, tall * size, ("tree", number), base=base, reach=130)
    if not base:
        block.shadow(x - 0.3 * wide, x + 0.3 * wide, s - 0.3 * wide, s + 0.3 * wide, 0.7 * tall)


def shrub(block: Block, rng: Generator, x: float, s: float, low: float, high: float) -> None:
    """A bush."""
    wide = rng.uniform(low, high)
    high, key = wide * rng.uniform(0.6, 0.9), ("bush", int(rng.integers(10)), 2.0, 1.5)
    block.sprite(x, s, wide, high, key, reach=60)


def lamp(block: Block, x: float, s: float, high: float) -> None:
    """A lamp on a post, its arm towards the path."""
    block.sprite(x, s, 0.14, high, ("pole", block.number // 6, high, 0.14), reach=100)
    arm = -1.6 if x > 0 else 1.6
    block.plane((x, high - 0.3, s), (arm, 0, 0), (0, 0.5, 0), ("lamp", 0), reach=100)
    block.lamps.append((x + 0.8 * arm, high - 0.2, s))


def wires(block: Block, side: int) -> None:
    """Telegraph poles and their lines."""
    x, high = side * (EDGE - 0.3), 7.0
    block.sprite(x, 2.0, 0.24, high, ("pole", block.number // 5 + 50, high, 0.24), reach=120)
    block.sprite(x, 2.0, 1.8, 0.25, ("pole", 77, 0.25, 1.8), base=high - 0.6, reach=90)
    for offset in (-0.7, 0.7):
        corner = (x + offset, high - 1.4, 2.0)
        block.plane(corner, (0, 0, BLOCK), (0, 1.2, 0), ("wire", 0), reach=90)
    if block.number % 2:
        corner, across = (-side * 8.0, high - 1.0, 2.0), (side * 8.0 + x, 0, 0)
        block.plane(corner, across, (0, 1.0, 0), ("wire", 1), reach=70)


def furniture(block: Block, rng: Generator, side: int, zone: str) -> None:
    """Signs, bins, benches and parapets on the pavement."""
    for _ in range(int(rng.integers(1, 5))):
        s, x = rng.uniform(0, BLOCK), side * (ROAD + rng.uniform(0.3, WALK - 0.4))
        what = rng.random()
        if what < 0.35:
            sign = ("sign", int(rng.integers(40)))
            block.sprite(side * (ROAD + 0.35), s, 0.9, 2.7, sign, reach=70)
        elif what < 0.85:
            block.sprite(x, s, 1.2, 1.2, ("clutter", int(rng.integers(40))), reach=55)
        else:
            board = ("board", int(rng.integers(60)), 1.4, 1.9, 120)
            block.wall(side * (ROAD + 0.4), s, s + 1.4, 1.9, board, base=0.5)
    avenue = block.draw("avenue", side, int(block.start) // 96)
    if zone in ("terrace", "shops") and avenue.random() < 0.4:
        for s in (3.0, 11.0, 19.0):
            tree(block, rng, side * (ROAD + 0.8), s, 4, 7)


def car(block: Block, number: int, x: float, s: float) -> None:
    """A car along the kerb or on the road, as a box of two sides and a rear."""
    left, right, high = x - 0.88, x + 0.88, 1.5
    shape = ("car_side", number)
    block.plane((left, 0, s + 4.3), (0, 0, -4.3), (0.12, high, 0), shape, "right", 90)
    block.plane((right, 0, s), (0, 0, 4.3), (-0.12, high, 0), shape, "left", 90)
    block.front(left, right, s, high, ("car_back", number), reach=90)
    block.shadow(left, right, s, s + 4.3, 0.8)


def person(block: Block, rng: Generator, x: float, s: float, reach: float = 60) -> None:
    """One of the world's people."""
    block.sprite(x, s, 0.9, 1.9, ("person", int(rng.integers(40))), reach=reach)


def parked(seed: int, number: int, run: int) -> Block:
    """Cars at the kerb; some go and come between drives."""
    block = Block(seed, number * BLOCK)
    for side in (-1, 1):
        busy = block.draw("parking", side, number // 4).uniform(0, 0.7)
        for slot in range(4):
            rng = block.draw("slot", side, number, slot)
            own = block.draw("slot", side, number, slot, run)
            there, index = rng.random() < busy, int(rng.integers(30))
            if own.random() < 0.5:
                there, index = own.random() < busy, int(own.integers(30))
            if there:
                car(block, index, side * (ROAD - 1.05), slot * 6.0 + rng.uniform(0.2, 1.2))
    return block


def moving(seed: int, run: int, frame: int, start: float, amount: float) -> Block:
    """Cars and people on the move around a camera at ``start``."""
    block = Block(seed, start)
    rng = generator(seed, "moving", run, frame)
    for _ in range(int(rng.poisson(3.0 * amount))):
        lane = float(rng.choice([-1.7, -1.7, 0.2, 1.2]))
        car(block, int(rng.integers(30)), lane + rng.normal(0, 0.15), rng.uniform(3.5, 35))
    for _ in range(int(rng.poisson(14 * amount))):
        side = rng.choice([-1, 1])
        x = side * (ROAD + rng.uniform(-0.8, WALK))
        person(block, rng, x, rng.uniform(2.0, 30))
    if rng.random() < 0.5 * amount:
        person(block, rng, rng.uniform(-1.6, 1.6), rng.uniform(2.2, 5), reach=90)
    return block
