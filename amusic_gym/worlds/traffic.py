"""What does not stay: parked cars, cars and people on the move."""

from __future__ import annotations

from amusic_gym.worlds.ground import BLOCK
from amusic_gym.worlds.layout import Block
from amusic_gym.worlds.noise import generator
from amusic_gym.worlds.street import ROAD, WALK


def car(block: Block, number: int, x: float, s: float) -> None:
    """A car along the kerb or on the road, as a box of two sides, rear and roof."""
    left, right, high = x - 0.88, x + 0.88, 1.5
    shape: tuple[object, ...] = ("car_side", number)
    block.plane((left, 0, s + 4.3), (0, 0, -4.3), (0.12, high, 0), shape, "right", 90)
    block.plane((right, 0, s), (0, 0, 4.3), (-0.12, high, 0), shape, "left", 90)
    block.front(left, right, s, high, ("car_back", number), reach=90)
    block.shadow(left, right, s, s + 4.3, 0.8)


def parked(seed: int, number: int, run: int) -> Block:
    """Cars at the kerb; some go and come between drives."""
    block = Block(number * BLOCK)
    for side in (-1, 1):
        busy = generator(seed, "parking", side, number // 4).uniform(0, 0.7)
        for slot in range(4):
            rng = generator(seed, "slot", side, number, slot)
            own = generator(seed, "slot", side, number, slot, run)
            there, index = rng.random() < busy, int(rng.integers(30))
            if own.random() < 0.5:
                there, index = own.random() < busy, int(own.integers(30))
            if there:
                car(block, index, side * (ROAD - 1.05), slot * 6.0 + rng.uniform(0.2, 1.2))
    return block


def moving(seed: int, run: int, frame: int, start: float, amount: float) -> Block:
    """Cars and people on the move around a camera at ``start``."""
    block = Block(start)
    rng = generator(seed, "moving", run, frame)
    for _ in range(int(rng.poisson(3.0 * amount))):
        lane = float(rng.choice([-1.7, -1.7, 0.2, 1.2]))
        car(block, int(rng.integers(30)), lane + rng.normal(0, 0.15), rng.uniform(3.5, 35))
    for _ in range(int(rng.poisson(14 * amount))):
        side = rng.choice([-1, 1])
        x = side * (ROAD + rng.uniform(-0.8, WALK))
        block.sprite(x, rng.uniform(2.0, 30), 0.9, 1.9, ("person", int(rng.integers(40))), reach=60)
    if rng.random() < 0.5 * amount:
        block.sprite(
            rng.uniform(-1.6, 1.6), rng.uniform(2.2, 5), 0.9, 1.9, ("person", int(rng.integers(40)))
        )
    return block
