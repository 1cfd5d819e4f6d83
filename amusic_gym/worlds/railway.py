"""Railways: woods, fields, cuttings, villages, stations and tunnels along one or two tracks."""

from __future__ import annotations

from amusic_gym.worlds.ground import BLOCK
from amusic_gym.worlds.layout import Block
from amusic_gym.worlds.noise import Generator, generator
from amusic_gym.worlds.street import STYLES, house, shrub, tree

ZONES = ("wood", "field", "cutting", "wood", "village", "bank", "station", "field", "bridge")


def tracks_of(seed: int) -> int:
    """One or two, for the whole route."""
    return int(generator(seed, "tracks").integers(1, 3))


def edge_of(seed: int, side: int) -> float:
    """Metres from the path to where the land beside the line begins."""
    return 3.2 if side < 0 else 4.0 + 4.2 * (tracks_of(seed) - 1)


def zone_of(seed: int, block: int, side: int) -> str:
    """What stands on a side of a block."""
    rng = generator(seed, "zone", side, block // 4)
    first, second = rng.integers(len(ZONES), size=2)
    change = int(rng.integers(1, 5))
    return ZONES[int(first if block % 4 < change else second)]


def build(seed: int, number: int) -> Block:
    """Block ``number`` of a railway."""
    block = Block(number * BLOCK)
    for side in (-1, 1):
        rng = generator(seed, "rail", number, side)
        zone = zone_of(seed, number, side)
        edge = edge_of(seed, side)
        BUILDERS[zone](block, rng, seed, number, side, edge)
        verge(block, rng, side, edge)
    rng = generator(seed, "line", number)
    if generator(seed, "electric").random() < 0.6:
        mast(block, seed, number)
    if zone_of(seed, number, 1) == "bridge" and number % 4 == 1:
        bridge(block, rng, seed, number)
    if rng.random() < 0.3:
        side = int(rng.choice([-1, 1]))
        block.sprite(
            side * edge_of(seed, side),
            rng.uniform(0, BLOCK),
            0.9,
            2.7,
            ("sign", int(rng.integers(40))),
        )
    if rng.random() < 0.25:
        side = int(rng.choice([-1, 1]))
        x, s = side * (edge_of(seed, side) + 0.5), rng.uniform(2, BLOCK)
        block.wall(x, s, s + 1.2, 1.6, ("cabinet", int(rng.integers(20)), 1.2, 1.6))
        a, b = sorted((x, x + side * 0.8))
        block.front(a, b, s, 1.6, ("cabinet", int(rng.integers(20)), 0.8, 1.6))
    return block


def moving(seed: int, run: int, frame: int, start: float, amount: float) -> Block:
    """A train on the other track, if there is one, and people beside the line."""
    block = Block(start)
    rng = generator(seed, "moving", run, frame)
    if tracks_of(seed) == 2 and rng.random() < 0.6 * amount:
        s = rng.uniform(-15, 40)
        for _ in range(int(rng.integers(1, 4))):
            block.wall(2.8, s, s + 20, 3.4, ("train", run % 5), base=0.5)
            block.front(2.8, 5.6, s, 3.4, ("train", run % 5), base=0.5)
            s += 20.4
    for _ in range(int(rng.poisson(5 * amount))):
        side = int(rng.choice([-1, 1]))
        x = side * (edge_of(seed, side) - rng.uniform(0, 1.2))
        key = ("person", int(rng.integers(40)))
        block.sprite(x, rng.uniform(3, 30), 0.9, 1.9, key, reach=60)
    return block


def verge(block: Block, rng: Generator, side: int, edge: float) -> None:
    """Weeds and bushes near the track."""
    for _ in range(int(rng.integers(3, 11))):
        x = side * (edge + abs(rng.normal(0.4, 1.2)))
        block.sprite(
            x,
            rng.uniform(0, BLOCK),
            1.6,
            rng.uniform(0.4, 1.0),
            ("grass", int(rng.integers(12)), 1.6, 0.8),
            reach=45,
        )
    for _ in range(int(rng.poisson(1.6))):
        shrub(block, rng, side * (edge + rng.uniform(0.5, 4)), rng.uniform(0, BLOCK), 0.8, 2.6)


def wood(block: Block, rng: Generator, seed: int, number: int, side: int, edge: float) -> None:
    """Trees close to the line, a dark wall of them behind."""
    back = edge + generator(seed, "woodline", side, number // 2).uniform(5, 11)
    high = float(generator(seed, "woodhigh", side, number // 2).integers(7, 13))
    block.wall(side * back, 0, BLOCK, high, ("thicket", int(rng.integers(8)), 24.0, 6.0), reach=150)
    for _ in range(int(rng.integers(3, 10))):
        tree(block, rng, side * rng.uniform(edge + 1.5, back), rng.uniform(0, BLOCK), 5, 13)


def field(block: Block, rng: Generator, seed: int, number: int, side: int, edge: float) -> None:
    """Open land: far woods, a fence, single trees and barns."""
    block.wall(side * 45, 0, BLOCK, 7, ("thicket", int(rng.integers(8)), 24.0, 6.0), reach=160)
    if generator(seed, "fieldfence", side, number // 4).random() < 0.6:
        block.wall(side * (edge + 1.5), 0, BLOCK, 1.2, ("fence", number // 4, 12.0, 1.1), reach=70)
    for _ in range(int(rng.integers(0, 3))):
        tree(block, rng, side * rng.uniform(edge + 4, 30), rng.uniform(0, BLOCK), 5, 13)
    if rng.random() < 0.3:
        x = side * rng.uniform(14, 30)
        house(
            block,
            seed,
            x,
            rng.uniform(0, 8),
            rng.uniform(8, 14),
            1,
            number * 10 + side,
            int(rng.integers(STYLES)),
            "hall",
            9,
        )


def cutting(block: Block, rng: Generator, seed: int, number: int, side: int, edge: float) -> None:
    """A slope of rock or earth beside the line, trees on its top."""
    high = float(generator(seed, "cutting", side, number // 2).uniform(2.5, 7))
    kind = "rock" if generator(seed, "rock", side, number // 4).random() < 0.6 else "slope"
    lean = high * (0.35 if kind == "rock" else 1.1)
    block.wall(side * edge, 0, BLOCK, high, (kind, number, 24.0, round(high * 1.2, 1)), lean=lean)
    top = edge + lean
    for _ in range(int(rng.integers(3, 9))):
        x = side * (top + rng.uniform(0, 4))
        tree(block, rng, x, rng.uniform(0, BLOCK), 4, 9, base=high - 0.2)


def bank(block: Block, rng: Generator, seed: int, number: int, side: int, edge: float) -> None:
    """A low bank with scrub."""
    high = 1.6
    block.wall(side * edge, 0, BLOCK, high, ("slope", number, 24.0, 2.6), lean=2.4)
    for _ in range(int(rng.integers(3, 9))):
        wide = rng.uniform(1.5, 4)
        key = ("bush", int(rng.integers(10)), 2.0, 1.5)
        block.sprite(
            side * (edge + rng.uniform(1.5, 6)),
            rng.uniform(0, BLOCK),
            wide,
            0.75 * wide,
            key,
            base=rng.uniform(0.6, 1.4),
        )
    block.wall(
        side * (edge + 16), 0, BLOCK, 8, ("thicket", int(rng.integers(8)), 24.0, 6.0), reach=140
    )


def village(block: Block, rng: Generator, seed: int, number: int, side: int, edge: float) -> None:
    """Houses with their backs to the line."""
    shared = int(generator(seed, "row", side, number // 4).integers(STYLES))
    s = rng.uniform(0, 4)
    while s < BLOCK - 8:
        wide = rng.uniform(7, 11)
        style = shared if rng.random() < 0.6 else int(rng.integers(STYLES))
        x = side * (edge + rng.uniform(4, 10))
        house(
            block,
            seed,
            x,
            s,
            wide,
            int(rng.integers(1, 3)),
            number * 10 + int(s) % 5 + side,
            style,
            "home",
            8,
            True,
        )
        s += wide + rng.uniform(1, 6)
    block.wall(side * (edge + 0.8), 0, BLOCK, 1.3, ("fence", number // 3 + 7, 12.0, 1.3), reach=70)
    for _ in range(int(rng.integers(1, 6))):
        tree(block, rng, side * (edge + rng.uniform(2, 5)), rng.uniform(0, BLOCK), 3, 8)


def station(block: Block, rng: Generator, seed: int, number: int, side: int, edge: float) -> None:
    """A platform with a shelter, boards and lamps."""
    x = side * (edge - 1.2)
    block.wall(x, 0, BLOCK, 0.9, ("platform", number, 24.0, 0.9), reach=110)
    top = (0.0, 0.0, float(BLOCK)) if side < 0 else (0.0, 0.0, -float(BLOCK))
    block.plane(
        (x, 0.9, 0.0 if side < 0 else BLOCK),
        top,
        (side * 5, 0.02, 0),
        ("paving", number, 24.0, 5.0),
    )
    style = int(rng.integers(STYLES))
    house(
        block,
        seed,
        side * (edge + 4),
        rng.uniform(0, 6),
        rng.uniform(9, 16),
        2,
        number * 10 + side,
        style,
        "shop",
        8,
    )
    s = rng.uniform(2, 16)
    block.wall(side * (edge + 1.5), s, s + 5, 1.1, ("board", number, 4.0, 1.0, 120), base=2.6)
    for post in (0.2, 4.8):
        block.sprite(side * (edge + 1.5), s + post, 0.12, 3.7, ("pole", 3, 4.0, 0.12))
    for s in (4.0, 16.0):
        block.sprite(side * edge, s, 0.14, 5.0, ("pole", number // 6, 5.0, 0.14))
        block.lamps.append((side * edge, 4.9, s))
        block.plane(
            (side * edge, 4.7, s), (-1.6 * side, 0, 0), (0, 0.5, 0), ("lamp", 0), "none", 100
        )
    for _ in range(int(rng.integers(0, 4))):
        key = ("person", int(rng.integers(40)))
        block.sprite(
            side * (edge + rng.uniform(0, 3)), rng.uniform(0, BLOCK), 0.9, 1.9, key, base=0.9
        )


def mast(block: Block, seed: int, number: int) -> None:
    """Masts of the overhead line with arms, and its wires."""
    side = -1 if generator(seed, "mastside").random() < 0.5 else 1
    x, high = side * (edge_of(seed, side) - 0.7), 7.2
    if number % 2 == 0:
        block.sprite(x, 1.0, 0.26, high, ("pole", 60, high, 0.26), reach=140)
        reach = abs(x) + 0.3
        block.plane(
            (min(x, x - side * reach), 6.2, 1.0),
            (reach, 0, 0),
            (0, 0.14, 0),
            ("pole", 61, 0.14, 4.0),
            "none",
            110,
        )
        block.plane(
            (min(x, x - side * reach), 5.3, 1.0),
            (reach, 0, 0),
            (0, 0.08, 0),
            ("pole", 62, 0.08, 4.0),
            "none",
            110,
        )
    block.plane((0.0, 5.2, 1.0), (0, 0, BLOCK), (0, 0.5, 0), ("wire", 0), "none", 70)
    block.plane((0.0, 5.9, 1.0), (0, 0, BLOCK), (0, 1.2, 0), ("wire", 1), "none", 70)


def bridge(block: Block, rng: Generator, seed: int, number: int) -> None:
    """A road bridge over the line on two abutments."""
    left, right = -edge_of(seed, -1) - 0.5, edge_of(seed, 1) + 0.5
    s, deep = rng.uniform(4, 14), 6.0
    for x, out in ((left, left - 14), (right, right + 14)):
        a, b = sorted((x, out))
        block.front(a, b, s, 5.5, ("masonry", number, 14.0, 5.5))
        block.wall(x, s, s + deep, 5.5, ("masonry", number + 1, 6.0, 5.5))
    block.front(left - 14, right + 14, s, 1.5, ("masonry", number + 2, 24.0, 1.5), base=5.3)
    block.wall(
        left, s, s + deep, 0.1, ("masonry", number + 3, 6.0, 1.0), base=5.3, lean=-(right - left)
    )
    block.shadow(left, right, s, s + deep, 1.0)


BUILDERS = {
    "wood": wood,
    "field": field,
    "cutting": cutting,
    "village": village,
    "bank": bank,
    "station": station,
    "bridge": wood,
}
