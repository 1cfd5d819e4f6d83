"""Where things stand: the pieces a block of the route is made of, and the lists they go in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym.worlds.ground import BLOCK
from amusic_gym.worlds.noise import Generator, generator

Point = tuple[float, float, float]  # metres to the right of the path, up, and along the route
Key = tuple[object, ...]  # name of a texture: a maker in `textures.MAKERS` and its arguments

LIT = {"left": 0.9, "right": -0.9, "front": -0.25, "none": 0.0}
"""What the sun finds of a plane that looks this way, -1 to 1."""


class Plane(NamedTuple):
    """A textured parallelogram."""

    corner: Point
    along: Point
    up: Point
    key: Key
    facing: float  # see LIT
    reach: float  # metres beyond which it is left out


@dataclass
class Block:
    """What stands along ``BLOCK`` metres of the route, which begin at ``start``."""

    seed: int  # of the world
    start: float
    planes: list[Plane] = field(default_factory=list)
    lamps: list[Point] = field(default_factory=list)
    shadows: list[tuple[float, float, float, float, float]] = field(default_factory=list)

    @property
    def number(self) -> int:
        """Which block of the route it is."""
        return int(self.start // BLOCK)

    def draw(self, *keys: int | str) -> Generator:
        """Random numbers of the world, by name."""
        return generator(self.seed, *keys)

    def plane(
        self, corner: Point, along: Point, up: Point, key: Key, facing: str = "none",
        reach: float = 140,
    ) -> None:  # fmt: skip
        """Add a textured parallelogram; ``corner`` counts along the route from the block's start.

        ``facing``: which way it looks, for the sun. ``reach``: metres beyond which it is left out.
        """
        corner = (corner[0], corner[1], corner[2] + self.start)
        self.planes.append(Plane(corner, along, up, key, LIT[facing], reach))

    def wall(
        self, x: float, s0: float, s1: float, high: float, key: Key, base: float = 0,
        lean: float = 0, reach: float = 140,
    ) -> None:  # fmt: skip
        """A wall along the route; its texture reads from left to right as seen from the path."""
        if x >= 0:
            self.plane((x, base, s1), (0, 0, s0 - s1), (lean, high, 0), key, "right", reach)
        else:
            self.plane((x, base, s0), (0, 0, s1 - s0), (-lean, high, 0), key, "left", reach)

    def front(
        self, x0: float, x1: float, s: float, high: float, key: Key, base: float = 0,
        reach: float = 140,
    ) -> None:  # fmt: skip
        """A wall across the route, facing the camera."""
        left, right = min(x0, x1), max(x0, x1)
        self.plane((left, base, s), (right - left, 0, 0), (0, high, 0), key, "front", reach)

    def sprite(
        self, x: float, s: float, wide: float, high: float, key: Key, base: float = 0,
        reach: float = 90,
    ) -> None:  # fmt: skip
        """Something that looks the same from all sides, standing at (x, s)."""
        self.plane((x - wide / 2, base, s), (wide, 0, 0), (0, high, 0), key, "none", reach)

    def shadow(self, x0: float, x1: float, s0: float, s1: float, high: float) -> None:
        """Let a body of this footprint and height cast a shadow."""
        self.shadows.append((x0, x1, s0, s1, high))

    def cast(self, side: float) -> list[NDArray[np.float64]]:
        """Its shadows on the ground for the sun at ``side``, as (4, 2) metres across and along."""
        done = []
        for x0, x1, s0, s1, high in self.shadows:
            length = min(high * abs(side), 14.0)
            reach = -length if side > 0 else length
            a, b = (x0 + reach, x1) if reach < 0 else (x0, x1 + reach)
            slant = 0.3 * length
            done.append(np.array([(a, s0 - slant), (b, s0), (b, s1), (a, s1 - slant)]))
        return done


@dataclass(frozen=True, eq=False)
class Things:
    """N planes and M lamps of finished blocks, along the route in absolute metres."""

    corners: NDArray[np.float64]  # (N, 3)
    alongs: NDArray[np.float64]  # (N, 3)
    ups: NDArray[np.float64]  # (N, 3)
    keys: tuple[Key, ...]
    facing: NDArray[np.float64]  # (N,)
    reach: NDArray[np.float64]  # (N,)
    lamps: NDArray[np.float64]  # (M, 3)

    @classmethod
    def of(cls, *blocks: Block) -> Things:
        """All that stands in some blocks."""

        def points(found: Sequence[Point]) -> NDArray[np.float64]:
            return np.array(found, np.float64).reshape(-1, 3)

        planes = [plane for block in blocks for plane in block.planes]
        return cls(
            points([plane.corner for plane in planes]),
            points([plane.along for plane in planes]),
            points([plane.up for plane in planes]),
            tuple(plane.key for plane in planes),
            np.array([plane.facing for plane in planes], np.float64),
            np.array([plane.reach for plane in planes], np.float64),
            points([(x, y, s + block.start) for block in blocks for x, y, s in block.lamps]),
        )


def split(rng: Generator, count: int) -> list[float]:
    """Cut the length of a block into ``count`` uneven parts."""
    parts = rng.uniform(0.7, 1.3, count)
    return [float(p) for p in parts / parts.sum() * BLOCK]


def zone_of(seed: int, block: int, side: int, zones: Sequence[str], length: int) -> str:
    """What stands on a side of a block; it stays so for ``length`` blocks on average."""
    rng = generator(seed, "zone", side, block // length)
    first, second = rng.integers(len(zones), size=2)
    change = int(rng.integers(1, length + 1))
    return zones[int(first if block % length < change else second)]
