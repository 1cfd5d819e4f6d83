"""Railways: woods, fields, cuttings, villages, stations and tunnels along one or two tracks."""

from amusic_gym.worlds import ground
from amusic_gym.worlds.ground import BLOCK, GroundPlan
from amusic_gym.worlds.layout import Block, zone_of
from amusic_gym.worlds.noise import Generator, generator
from amusic_gym.worlds.street import STYLES, house, shrub, tree

SPACING = 4.0
EYE = 2.6
SWAY = 0.12
BENDS = ((16.0, 520.0), (5.0, 260.0))

ZONES = ("wood", "field", "cutting", "wood", "village", "bank", "station", "field", "bridge")
ZONE_BLOCKS = 4  # a zone stays so for as many blocks on average


def tracks_of(seed: int) -> int:
    """One or two, for the whole route."""
    return int(generator(seed, "tracks").integers(1, 3))


def edge_of(seed: int, side: int) -> float:
    """Metres from the path to where the land beside the line begins."""
    return 3.2 if side < 0 else 4.0 + 4.2 * (tracks_of(seed) - 1)


def plan(seed: int, number: int, season: str) -> GroundPlan:
    """The ground of a block."""
    zone = zone_of(seed, number, 1, ZONES, ZONE_BLOCKS)
    return ground.rail(seed, number, zone, season, tracks_of(seed))


def build(seed: int, number: int) -> Block:
    """Block ``number`` of a railway."""
    block = Block(seed, number * BLOCK)
    for side in (-1, 1):
        rng = block.draw("rail", number, side)
        edge = edge_of(seed, side)
        BUILDERS[zone_of(seed, number, side, ZONES, ZONE_BLOCKS)](block, rng, side, edge)
        verge(block, rng, side, edge)
    rng = block.draw("line", number)
    if block.draw("electric").random() < 0.6:
        mast(block)
    if number % 4 == 1 and zone_of(seed, number, 1, ZONES, ZONE_BLOCKS) == "bridge":
        bridge(block, rng)
    if rng.random() < 0.3:
        side = int(rng.choice([-1, 1]))
        s, sign = rng.uniform(0, BLOCK), ("sign", int(rng.integers(40)))
        block.sprite(side * edge_of(seed, side), s, 0.9, 2.7, sign)
    if rng.random() < 0.25:
        side = int(rng.choice([-1, 1]))
        x, s = side * (edge_of(seed, side) + 0.5), rng.uniform(2, BLOCK)
        block.wall(x, s, s + 1.2, 1.6, ("cabinet", int(rng.integers(20)), 1.2, 1.6))
        block.front(x, x + side * 0.8, s, 1.6, ("cabinet", int(rng.integers(20)), 0.8, 1.6))
    return block


def moving(seed: int, run: int, frame: int, start: float, amount: float) -> Block:
    """A train on the other track, if there is one, and people beside the line."""
    block = Block(seed, start)
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
        s, high = rng.uniform(0, BLOCK), rng.uniform(0.4, 1.0)
        block.sprite(x, s, 1.6, high, ("grass", int(rng.integers(12)), 1.6, 0.8), reach=45)
    for _ in range(int(rng.poisson(1.6))):
        shrub(block, rng, side * (edge + rng.uniform(0.5, 4)), rng.uniform(0, BLOCK), 0.8, 2.6)


def far_wood(block: Block, rng: Generator, x: float, high: float, reach: float) -> None:
    """A dark wall of trees along the whole block."""
    key = ("thicket", int(rng.integers(8)), 24.0, 6.0)
    block.wall(x, 0, BLOCK, high, key, reach=reach)


def wood(block: Block, rng: Generator, side: int, edge: float) -> None:
    """Trees close to the line, a dark wall of them behind."""
    stretch = block.number // 2
    back = edge + block.draw("woodline", side, stretch).uniform(5, 11)
    high = float(block.draw("woodhigh", side, stretch).integers(7, 13))
    far_wood(block, rng, side * back, high, 150)
    for _ in range(int(rng.integers(3, 10))):
        tree(block, rng, side * rng.uniform(edge + 1.5, back), rng.uniform(0, BLOCK), 5, 13)


def field(block: Block, rng: Generator, side: int, edge: float) -> None:
    """Open land: far woods, a fence, single trees and barns."""
    far_wood(block, rng, side * 45, 7, 160)
    stretch = block.number // 4
    if block.draw("fieldfence", side, stretch).random() < 0.6:
        block.wall(side * (edge + 1.5), 0, BLOCK, 1.2, ("fence", stretch, 12.0, 1.1), reach=70)
    for _ in range(int(rng.integers(0, 3))):
        tree(block, rng, side * rng.uniform(edge + 4, 30), rng.uniform(0, BLOCK), 5, 13)
    if rng.random() < 0.3:
        x, s, wide = side * rng.uniform(14, 30), rng.uniform(0, 8), rng.uniform(8, 14)
        style = int(rng.integers(STYLES))
        house(block, x, s, wide, 1, block.number * 10 + side, style, "hall")


def cutting(block: Block, rng: Generator, side: int, edge: float) -> None:
    """A slope of rock or earth beside the line, trees on its top."""
    number = block.number
    high = float(block.draw("cutting", side, number // 2).uniform(2.5, 7))
    kind = "rock" if block.draw("rock", side, number // 4).random() < 0.6 else "slope"
    lean = high * (0.35 if kind == "rock" else 1.1)
    block.wall(side * edge, 0, BLOCK, high, (kind, number, 24.0, round(high * 1.2, 1)), lean=lean)
    top = edge + lean
    for _ in range(int(rng.integers(3, 9))):
        x = side * (top + rng.uniform(0, 4))
        tree(block, rng, x, rng.uniform(0, BLOCK), 4, 9, base=high - 0.2)


def bank(block: Block, rng: Generator, side: int, edge: float) -> None:
    """A low bank with scrub."""
    block.wall(side * edge, 0, BLOCK, 1.6, ("slope", block.number, 24.0, 2.6), lean=2.4)
    for _ in range(int(rng.integers(3, 9))):
        wide = rng.uniform(1.5, 4)
        key = ("bush", int(rng.integers(10)), 2.0, 1.5)
        x, s = side * (edge + rng.uniform(1.5, 6)), rng.uniform(0, BLOCK)
        block.sprite(x, s, wide, 0.75 * wide, key, base=rng.uniform(0.6, 1.4))
    far_wood(block, rng, side * (edge + 16), 8, 140)


def village(block: Block, rng: Generator, side: int, edge: float) -> None:
    """Houses with their backs to the line."""
    number = block.number
    shared = int(block.draw("row", side, number // 4).integers(STYLES))
    s = rng.uniform(0, 4)
    while s < BLOCK - 8:
        wide = rng.uniform(7, 11)
        style = shared if rng.random() < 0.6 else int(rng.integers(STYLES))
        x, storeys = side * (edge + rng.uniform(4, 10)), int(rng.integers(1, 3))
        identity = number * 10 + int(s) % 5 + side
        house(block, x, s, wide, storeys, identity, style, "home", 8, True)
        s += wide + rng.uniform(1, 6)
    block.wall(side * (edge + 0.8), 0, BLOCK, 1.3, ("fence", number // 3 + 7, 12.0, 1.3), reach=70)
    for _ in range(int(rng.integers(1, 6))):
        tree(block, rng, side * (edge + rng.uniform(2, 5)), rng.uniform(0, BLOCK), 3, 8)


def station(block: Block, rng: Generator, side: int, edge: float) -> None:
    """A platform with a shelter, boards and lamps."""
    number, x = block.number, side * (edge - 1.2)
    block.wall(x, 0, BLOCK, 0.9, ("platform", number, 24.0, 0.9), reach=110)
    corner, along = (x, 0.9, 0.0 if side < 0 else BLOCK), (0.0, 0.0, -side * float(BLOCK))
    block.plane(corner, along, (side * 5, 0.02, 0), ("paving", number, 24.0, 5.0))
    style = int(rng.integers(STYLES))
    s, wide = rng.uniform(0, 6), rng.uniform(9, 16)
    house(block, side * (edge + 4), s, wide, 2, number * 10 + side, style, "shop", 8)
    s = rng.uniform(2, 16)
    block.wall(side * (edge + 1.5), s, s + 5, 1.1, ("board", number, 4.0, 1.0, 120), base=2.6)
    for post in (0.2, 4.8):
        block.sprite(side * (edge + 1.5), s + post, 0.12, 3.7, ("pole", 3, 4.0, 0.12))
    for s in (4.0, 16.0):
        block.sprite(side * edge, s, 0.14, 5.0, ("pole", number // 6, 5.0, 0.14))
        block.lamps.append((side * edge, 4.9, s))
        corner = (side * edge, 4.7, s)
        block.plane(corner, (-1.6 * side, 0, 0), (0, 0.5, 0), ("lamp", 0), reach=100)
    for _ in range(int(rng.integers(0, 4))):
        key = ("person", int(rng.integers(40)))
        x, s = side * (edge + rng.uniform(0, 3)), rng.uniform(0, BLOCK)
        block.sprite(x, s, 0.9, 1.9, key, base=0.9)


def mast(block: Block) -> None:
    """Masts of the overhead line with arms, and its wires."""
    side = -1 if block.draw("mastside").random() < 0.5 else 1
    x, high = side * (edge_of(block.seed, side) - 0.7), 7.2
    if block.number % 2 == 0:
        block.sprite(x, 1.0, 0.26, high, ("pole", 60, high, 0.26), reach=140)
        reach = abs(x) + 0.3
        for pole, level, thick in ((61, 6.2, 0.14), (62, 5.3, 0.08)):
            corner, key = (min(x, x - side * reach), level, 1.0), ("pole", pole, thick, 4.0)
            block.plane(corner, (reach, 0, 0), (0, thick, 0), key, reach=110)
    for wire, level, sag in ((0, 5.2, 0.5), (1, 5.9, 1.2)):
        block.plane((0.0, level, 1.0), (0, 0, BLOCK), (0, sag, 0), ("wire", wire), reach=70)


def bridge(block: Block, rng: Generator) -> None:
    """A road bridge over the line on two abutments."""
    number = block.number
    left, right = -edge_of(block.seed, -1) - 0.5, edge_of(block.seed, 1) + 0.5
    s, deep = rng.uniform(4, 14), 6.0
    for x, out in ((left, left - 14), (right, right + 14)):
        block.front(x, out, s, 5.5, ("masonry", number, 14.0, 5.5))
        block.wall(x, s, s + deep, 5.5, ("masonry", number + 1, 6.0, 5.5))
    block.front(left - 14, right + 14, s, 1.5, ("masonry", number + 2, 24.0, 1.5), base=5.3)
    below = ("masonry", number + 3, 6.0, 1.0)
    block.wall(left, s, s + deep, 0.1, below, base=5.3, lean=-(right - left))
    block.shadow(left, right, s, s + deep, 1.0)


BUILDERS = {
    "wood": wood, "field": field, "cutting": cutting, "village": village, "bank": bank,
    "station": station, "bridge": wood,
}  # fmt: skip
