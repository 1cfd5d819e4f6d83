"""Where things stand: the pieces a block of the route is made of, and the lists they go in."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from amusic_gym.worlds.ground import BLOCK, Shadow

Key = tuple[object, ...]
"""Name of a texture: a maker in `textures.MAKERS` and its arguments."""

LIT = {"left": 0.9, "right": -0.9, "front": -0.25, "none": 0.0}


@dataclass
class Block:
    """What stands along ``BLOCK`` metres of the route.

    Places are (metres to the right of the path, metres up, metres along the route).
    """

    start: float
    corners: list[tuple[float, float, float]] = field(default_factory=list)
    alongs: list[tuple[float, float, float]] = field(default_factory=list)
    ups: list[tuple[float, float, float]] = field(default_factory=list)
    keys: list[Key] = field(default_factory=list)
    facing: list[float] = field(default_factory=list)
    reach: list[float] = field(default_factory=list)
    lamps: list[tuple[float, float, float]] = field(default_factory=list)
    shadows: list[tuple[float, float, float, float, float]] = field(default_factory=list)

    def plane(
        self, corner: tuple[float, float, float], along: tuple[float, float, float],
        up: tuple[float, float, float], key: Key, facing: str = "none", reach: float = 140,
    ) -> None:  # fmt: skip
        """Add a textured parallelogram; ``corner`` counts along the route from the block's start.

        ``facing``: which way it looks, for the sun. ``reach``: metres beyond which it is left out.
        """
        self.corners.append((corner[0], corner[1], corner[2] + self.start))
        self.alongs.append(along)
        self.ups.append(up)
        self.keys.append(key)
        self.facing.append(LIT[facing])
        self.reach.append(reach)

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
        self,
        x0: float,
        x1: float,
        s: float,
        high: float,
        key: Key,
        base: float = 0,
        reach: float = 140,
    ) -> None:
        """A wall across the route, facing the camera."""
        self.plane((x0, base, s), (x1 - x0, 0, 0), (0, high, 0), key, "front", reach)

    def sprite(
        self,
        x: float,
        s: float,
        wide: float,
        high: float,
        key: Key,
        base: float = 0,
        reach: float = 90,
    ) -> None:
        """Something that looks the same from all sides, standing at (x, s)."""
        self.plane((x - wide / 2, base, s), (wide, 0, 0), (0, high, 0), key, "none", reach)

    def shadow(self, x0: float, x1: float, s0: float, s1: float, high: float) -> None:
        """Let a body of this footprint and height cast a shadow."""
        self.shadows.append((x0, x1, s0, s1, high))

    def arrays(self) -> Arrays:
        """All of it as arrays."""
        return Arrays(
            np.array(self.corners).reshape(-1, 3),
            np.array(self.alongs).reshape(-1, 3),
            np.array(self.ups).reshape(-1, 3),
            tuple(self.keys),
            np.array(self.facing),
            np.array(self.reach),
            np.array(self.lamps).reshape(-1, 3) + (0, 0, self.start),
        )


@dataclass(frozen=True, eq=False)
class Arrays:
    """A finished block: N planes and their lamps, along the route in absolute metres."""

    corners: NDArray[np.float64]  # (N, 3)
    alongs: NDArray[np.float64]  # (N, 3)
    ups: NDArray[np.float64]  # (N, 3)
    keys: tuple[Key, ...]
    facing: NDArray[np.float64]  # (N,)
    reach: NDArray[np.float64]  # (N,)
    lamps: NDArray[np.float64]  # (M, 3)


def cast(shadows: list[tuple[float, float, float, float, float]], side: float) -> list[Shadow]:
    """Shadows on the ground of a block, for the sun at ``side``."""
    done = []
    for x0, x1, s0, s1, high in shadows:
        length = min(high * abs(side), 14.0)
        reach = -length if side > 0 else length
        a, b = (x0 + reach, x1) if reach < 0 else (x0, x1 + reach)
        slant = 0.3 * length
        corners = ((a, s0 - slant), (b, s0), (b, s1), (a, s1 - slant))
        done.append(Shadow(corners))
    return done


def split(rng: np.random.Generator, count: int) -> list[float]:
    """Cut the length of a block into ``count`` uneven parts."""
    parts = rng.uniform(0.7, 1.3, count)
    return [float(p) for p in parts / parts.sum() * BLOCK]
