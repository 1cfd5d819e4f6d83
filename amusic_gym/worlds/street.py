"""Streets: terraces, shops, suburbs, parks, offices and works along a road."""

from __future__ import annotations

import numpy as np

from amusic_gym.worlds.facades import style_of
from amusic_gym.worlds.ground import BLOCK
from amusic_gym.worlds.layout import Block, split
from amusic_gym.worlds.noise import Generator, generator

ZONES = ("terrace", "shops", "suburb", "park", "office", "works", "suburb", "terrace")
STYLES = 9
ROAD = 3.6
WALK = 2.4


def zone_of(seed: int, block: int, side: int) -> str:
    """What stands on a side of a block; it stays so for three blocks on average."""
    rng = generator(seed, "zone", side, block // 3)
    first, second = rng.integers(len(ZONES), size=2)
    change = int(rng.integers(1, 4))
    return ZONES[int(first if block % 3 < change else second)]


def build(seed: int, number: int) -> Block:
    """Block ``number`` of a street."""
    block = Block(number * BLOCK)
    for side in (-1, 1):
        rng = generator(seed, "street", number, side)
        zone = zone_of(seed, number, side)
        {"terrace": terrace, "shops": terrace, "office": office, "works": works, "park": park,
         "suburb": suburb}[zone](block, rng, seed, number, side, zone)  # fmt: skip
        furniture(block, rng, seed, side, zone)
    rng = generator(seed, "lamps", number)
    side = int(generator(seed, "lampside", number // 8).choice([-1, 1]))
    lamp(block, seed, number, side, rng.uniform(1, 5))
    lamp(block, seed, number, -side, 12 + rng.uniform(0, 5))
    if generator(seed, "wires", number // 4).random() < 0.5:
        wires(block, seed, number, -side)
    return block


def house(
    block: Block, seed: int, x: float, s0: float, wide: float, storeys: int, number: int,
    style: int, use: str, deep: float = 9.0, gap: bool = False,
) -> None:  # fmt: skip
    """A house with its front at ``x``: front, side towards the camera, roof."""
    side = 1 if x > 0 else -1
    high = storeys * style_of(seed, style).storey + 0.7
    wide = round(wide, 2)
    block.wall(x, s0, s0 + wide, high, ("facade", number, style, wide, storeys, use))
    a, b = sorted((x, x + side * deep))
    sides = ("side", number, style, deep, round(high, 2))
    block.front(a, b, s0, high, sides, reach=110)
    if storeys <= 3 and use != "hall":
        rise = 2.6
        end = s0 + wide
        roofing = ("roof", number, wide, 4.0)
        corner = (x - side * 0.3, high - 0.1, end if side > 0 else s0)
        run = -wide if side > 0 else wide
        block.plane(corner, (0, 0, run), (side * deep / 2, rise, 0), roofing, "none", 120)
        gable = ("gable", number, style, deep, rise)
        block.front(a, b, s0, rise, gable, base=high - 0.1, reach=90)
        if number % 3 == 0 or gap:
            block.sprite(
                x + side * 2.6, s0 + 0.7 * wide, 0.8, 1.6, ("pole", number, 1.6, 0.8), high + 0.8
            )
    block.shadow(a, b, s0, s0 + wide, high)


def terrace(block: Block, rng: Generator, seed: int, number: int, side: int, zone: str) -> None:
    """Houses wall to wall; often one type repeats, now and then the very same house."""
    shared = int(generator(seed, "row", side, number // 3).integers(STYLES))
    repeat = generator(seed, "repeat", side, number // 3).random() < 0.35
    x = side * (ROAD + WALK)
    s = 0.0
    parts = split(rng, int(rng.integers(2, 5))) if not repeat else [BLOCK / 4] * 4
    storeys = int(rng.integers(2, 5))
    for part, wide in enumerate(parts):
        style = shared if repeat or rng.random() < 0.45 else int(rng.integers(STYLES))
        if not repeat:
            storeys = int(np.clip(storeys + rng.integers(-1, 2), 2, 5))
        use = "shop" if zone == "shops" or rng.random() < 0.12 else "home"
        identity = shared * 1000 + 7 if repeat else number * 10 + part + (5 if side > 0 else 0)
        back = 0.0 if rng.random() < 0.7 else rng.uniform(0.3, 1.5)
        house(block, seed, x + side * back, s, wide, storeys, identity, style, use)
        s += wide


def office(block: Block, rng: Generator, seed: int, number: int, side: int, zone: str) -> None:
    """One large building with a forecourt."""
    style = int(rng.integers(STYLES))
    wide = rng.uniform(14, 21)
    s = rng.uniform(0.5, BLOCK - wide - 0.5)
    x = side * (ROAD + WALK + rng.uniform(1, 5))
    house(block, seed, x, s, wide, int(rng.integers(3, 7)), number * 10 + side, style, "home", 14)
    for _ in range(int(rng.integers(1, 4))):
        tree(block, rng, side * (ROAD + WALK + rng.uniform(0.2, 1.0)), rng.uniform(0, BLOCK), 4, 7)


def works(block: Block, rng: Generator, seed: int, number: int, side: int, zone: str) -> None:
    """A hall behind a wall or fence, hoardings."""
    style = int(rng.integers(STYLES))
    wide = rng.uniform(12, 20)
    s = rng.uniform(0, BLOCK - wide)
    x = side * (ROAD + WALK + rng.uniform(3, 8))
    house(block, seed, x, s, wide, int(rng.integers(1, 3)), number * 10 + side, style, "hall", 16)
    edge = side * (ROAD + WALK + 0.1)
    for part in range(3):
        kind = "low_wall" if rng.random() < 0.5 else "fence"
        block.wall(
            edge, part * 8.0, part * 8.0 + 7.5, 1.9, (kind, number * 3 + part, 7.5, 1.9), reach=80
        )
    if rng.random() < 0.7:
        s = rng.uniform(0, 18)
        block.wall(
            edge - side * 0.1, s, s + 4.0, 2.6, ("board", number + side, 4.0, 2.6, 0), base=0.6
        )
    if rng.random() < 0.5:
        tree(block, rng, edge + side * 2, rng.uniform(0, BLOCK), 5, 9)


def park(block: Block, rng: Generator, seed: int, number: int, side: int, zone: str) -> None:
    """Trees and bushes at several depths, a fence or hedge in front."""
    edge = ROAD + WALK
    for depth in (edge + 9, edge + 5, edge + 1.2):
        for _ in range(int(rng.integers(1, 5))):
            tree(block, rng, side * (depth + rng.uniform(-1, 2)), rng.uniform(0, BLOCK), 5, 12)
    for _ in range(int(rng.integers(2, 6))):
        shrub(block, rng, side * (edge + rng.uniform(0.6, 8)), rng.uniform(0, BLOCK), 1.2, 3.5)
    block.wall(side * (edge + 15), 0, BLOCK, 6, ("thicket", number % 5, 24.0, 6.0), reach=120)
    if rng.random() < 0.6:
        block.wall(side * (edge + 0.2), 0, BLOCK, 1.1, ("fence", number // 4, 12.0, 1.1), reach=60)


def suburb(block: Block, rng: Generator, seed: int, number: int, side: int, zone: str) -> None:
    """Detached houses in gardens."""
    edge = ROAD + WALK
    shared = int(generator(seed, "row", side, number // 4).integers(STYLES))
    count = int(rng.integers(1, 3))
    for part in range(count):
        wide = rng.uniform(7.5, 10)
        s = part * BLOCK / count + rng.uniform(0.5, max(0.6, BLOCK / count - wide - 0.5))
        style = shared if rng.random() < 0.6 else int(rng.integers(STYLES))
        x = side * (edge + rng.uniform(3, 6))
        house(
            block,
            seed,
            x,
            s,
            wide,
            int(rng.integers(1, 3)),
            number * 10 + part + side,
            style,
            "home",
            8,
            True,
        )
    s = 0.0
    while s < BLOCK - 1:
        wide = min(rng.uniform(3, 8), BLOCK - s)
        kind = int(rng.integers(4))
        if kind == 0:
            high = round(rng.uniform(0.9, 2.2), 1)
            block.wall(
                side * (edge + 0.5),
                s,
                s + wide,
                high,
                ("hedge", int(rng.integers(12)), 6.0, high),
                reach=70,
            )
        elif kind == 1:
            block.wall(
                side * edge,
                s,
                s + wide,
                1.0,
                ("low_wall", int(rng.integers(99)), 6.0, 1.0),
                reach=70,
            )
        elif kind == 2:
            block.wall(
                side * edge, s, s + wide, 1.1, ("fence", int(rng.integers(99)), 6.0, 1.1), reach=70
            )
        s += wide + (0 if rng.random() < 0.5 else 2.8)
    for _ in range(int(rng.integers(2, 6))):
        tree(block, rng, side * (edge + rng.uniform(0.8, 4)), rng.uniform(0, BLOCK), 3, 8)
    for _ in range(int(rng.integers(2, 7))):
        shrub(block, rng, side * (edge + rng.uniform(0.5, 3)), rng.uniform(0, BLOCK), 0.8, 2.4)


TREES: tuple[tuple[int, str], ...] = (
    (5, "broad"), (8, "broad"), (8, "broad"), (11, "broad"), (11, "broad"), (6, "slim"),
    (9, "slim"), (11, "slim"), (7, "conifer"), (9, "conifer"), (12, "conifer"),
)  # fmt: skip
"""Height in metres and kind of the trees that a world has; each stands in many places."""


def tree(
    block: Block, rng: Generator, x: float, s: float, low: float, high: float, base: float = 0
) -> None:
    """A tree of about ``low`` to ``high`` metres, one of the world's."""
    number = int(rng.integers(len(TREES)))
    tall, kind = TREES[number]
    size = float(np.clip(rng.uniform(low, high) / tall, 0.6, 1.4))
    wide = {"broad": 0.95, "slim": 0.55, "conifer": 0.4}[kind] * tall * size
    block.sprite(x, s, wide, tall * size, ("tree", number, tall, kind), base=base, reach=130)
    if not base:
        block.shadow(x - 0.3 * wide, x + 0.3 * wide, s - 0.3 * wide, s + 0.3 * wide, 0.7 * tall)


def shrub(block: Block, rng: Generator, x: float, s: float, low: float, high: float) -> None:
    """A bush."""
    wide = rng.uniform(low, high)
    block.sprite(
        x,
        s,
        wide,
        wide * rng.uniform(0.6, 0.9),
        ("bush", int(rng.integers(10)), 2.0, 1.5),
        reach=60,
    )


def lamp(block: Block, seed: int, number: int, side: int, s: float) -> None:
    """A street lamp over the kerb."""
    del seed
    x, high = side * (ROAD + 0.5), 6.0
    block.sprite(x, s, 0.14, high, ("pole", number // 6, high, 0.14), reach=100)
    arm = -1.6 * side
    block.plane((x, high - 0.3, s), (arm, 0, 0), (0, 0.5, 0), ("lamp", 0), "none", 100)
    block.lamps.append((x + 0.8 * arm, high - 0.2, s))


def wires(block: Block, seed: int, number: int, side: int) -> None:
    """Telegraph poles and their lines."""
    x, high = side * (ROAD + WALK - 0.3), 7.0
    block.sprite(x, 2.0, 0.24, high, ("pole", number // 5 + 50, high, 0.24), reach=120)
    block.sprite(x, 2.0, 1.8, 0.25, ("pole", 77, 0.25, 1.8), base=high - 0.6, reach=90)
    for offset in (-0.7, 0.7):
        block.plane(
            (x + offset, high - 1.4, 2.0), (0, 0, BLOCK), (0, 1.2, 0), ("wire", 0), "none", 90
        )
    if number % 2:
        block.plane(
            (-side * 8.0, high - 1.0, 2.0),
            (side * 8.0 + x, 0, 0),
            (0, 1.0, 0),
            ("wire", 1),
            "none",
            70,
        )


def furniture(block: Block, rng: Generator, seed: int, side: int, zone: str) -> None:
    """Signs, bins, benches and parapets on the pavement."""
    for _ in range(int(rng.integers(1, 5))):
        s, x = rng.uniform(0, BLOCK), side * (ROAD + rng.uniform(0.3, WALK - 0.4))
        what = rng.random()
        if what < 0.35:
            block.sprite(
                side * (ROAD + 0.35), s, 0.9, 2.7, ("sign", int(rng.integers(40))), reach=70
            )
        elif what < 0.85:
            block.sprite(x, s, 1.2, 1.2, ("clutter", int(rng.integers(40))), reach=55)
        else:
            block.wall(
                side * (ROAD + 0.4),
                s,
                s + 1.4,
                1.9,
                ("board", int(rng.integers(60)), 1.4, 1.9, 120),
                base=0.5,
            )
    if (
        zone in ("terrace", "shops")
        and generator(seed, "avenue", side, int(block.start) // 96).random() < 0.4
    ):
        for s in (3.0, 11.0, 19.0):
            tree(block, rng, side * (ROAD + 0.8), s, 4, 7)
