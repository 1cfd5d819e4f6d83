"""A route: its path, its blocks and all that is kept between frames."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import suggest
from amusic_gym.worlds import corridor, ground, railway, sky, street, traffic
from amusic_gym.worlds.conditions import Look
from amusic_gym.worlds.ground import Plan, Texture
from amusic_gym.worlds.layout import Arrays, Block, cast
from amusic_gym.worlds.levels import Levels, pyramid
from amusic_gym.worlds.noise import generator
from amusic_gym.worlds.textures import Textures

Kind = Literal["street", "rail", "corridor"]
KINDS: tuple[Kind, ...] = ("street", "rail", "corridor")

AHEAD = 6
"""Blocks drawn from the camera's own one on."""

KEPT = 96
"""Blocks, maps, skies and the like kept in memory."""

Kept = TypeVar("Kept")

# Per kind: camera height in metres; amplitude in metres and length in metres of the path's bends.
EYE = {"street": 1.6, "rail": 2.6, "corridor": 1.35}
BENDS = {"street": ((7.0, 330.0), (2.5, 170.0)), "rail": ((16.0, 520.0), (5.0, 260.0)),
         "corridor": ((1.2, 95.0), (0.35, 47.0))}  # fmt: skip


class World:
    """A procedural route that goes on for ever; the same for equal arguments, bit for bit.

    Args:
        seed: any whole number >= 0.
        kind: "street", "rail" or "corridor"; None lets the seed choose.

    Raises:
        ValueError: for another seed or kind.
    """

    def __init__(self, seed: int, kind: Kind | None = None) -> None:
        self.seed = whole("seed", seed, 0)
        if kind is not None and kind not in KINDS:
            raise ValueError(suggest("kind", kind, KINDS))
        self.kind: Kind = kind or KINDS[int(generator(self.seed, "kind").integers(3))]
        self.eye = EYE[self.kind]
        self.textures = Textures(self.seed)
        self._kept: OrderedDict[Any, Any] = OrderedDict()
        rng = generator(self.seed, "path")
        self._waves = [(a, 2 * np.pi / b, rng.uniform(0, 2 * np.pi)) for a, b in BENDS[self.kind]]

    def path(self, along: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres the path lies to the right of a straight line, at metres along it."""
        waves = [a * np.sin(w * along + phase) for a, w, phase in self._waves]
        return np.asarray(sum(waves), np.float64)

    def heading(self, along: float) -> float:
        """Slope of the path, in radians (small)."""
        return float(sum(a * w * np.cos(w * along + phase) for a, w, phase in self._waves))

    def things(self, first: int, run: int) -> Arrays:
        """Everything that stands in the blocks from ``first`` on, in one set of arrays."""

        def make() -> Arrays:
            found = [self.block(number) for number in range(first, first + AHEAD)]
            if self.kind == "street":
                found += [self._parked(number, run) for number in range(first, first + AHEAD)]
            return join([block.arrays() for block in found])

        return self._keep(("things", first, run), make)

    def block(self, number: int) -> Block:
        """What stands in a block, but for what goes and comes."""
        build = {"street": street.build, "rail": railway.build, "corridor": corridor.build}[
            self.kind
        ]
        return self._keep(("block", number), lambda: build(self.seed, number))

    def _parked(self, number: int, run: int) -> Block:
        return self._keep(("parked", number, run), lambda: traffic.parked(self.seed, number, run))

    def ground(self, first: int, look: Look, run: int) -> Levels:
        """Map of the ground from block ``first`` on."""
        if self.kind == "corridor":
            season, light, run = "summer", (0.0, 0.0), 0
        else:
            season, light = look.season, (round(look.side, 2), round(look.shadow, 2))

        def plan(number: int) -> Texture:
            base = self._keep(
                ("plan", number, season), lambda: self._plan(number, season).texture()
            )
            side, dark = light
            if not dark:
                return base
            shadows = cast(self.block(number).shadows, side)
            if self.kind == "street":
                shadows += cast(self._parked(number, run).shadows, side)
            return ground.shaded(base, shadows, dark)

        def make() -> Levels:
            numbers = range(first, first + AHEAD)
            maps = [self._keep(("map", n, season, light, run), partial(plan, n)) for n in numbers]
            return pyramid(np.concatenate(maps))

        return self._keep(("ground", first, season, light, run), make)

    def ceiling(self, first: int) -> Levels:
        """Map of a corridor's ceiling from block ``first`` on."""

        def make() -> Levels:
            numbers = range(first, first + AHEAD)
            return pyramid(
                np.concatenate([ground.ceiling(self.seed, n).texture() for n in numbers])
            )

        return self._keep(("ceiling", first), make)

    def _plan(self, number: int, season: str) -> Plan:
        if self.kind == "corridor":
            return ground.floor(self.seed, number)
        if self.kind == "rail":
            zone = railway.zone_of(self.seed, number, 1)
            return ground.rail(self.seed, number, zone, season, railway.tracks_of(self.seed))
        zone = street.zone_of(self.seed, number, 1)
        return ground.street(self.seed, number, zone, season, street.ROAD, street.WALK)

    def clouds(self, look: Look, run: int) -> NDArray[np.uint8]:
        """(512, 4096, 3) panorama of the sky with the skyline before it."""
        key = ("sky", look.season, look.cover, look.zenith, look.horizon, look.haze, look.fog, run)

        def make() -> NDArray[np.uint8]:
            if self.kind == "corridor":  # its far end, a few pixels wide
                dull = 150 * np.asarray(look.ambient)
                return np.full((sky.RISE, sky.ROUND, 3), np.clip(dull, 0, 255), np.uint8)
            above = np.asarray(look.zenith, np.float32)
            level = np.asarray(look.horizon, np.float32)
            haze, ambient = np.asarray(look.haze, np.float32), np.asarray(look.ambient, np.float32)
            picture = sky.clouds(self.seed, run, look.cover, above, level)
            clear = np.float32(np.exp(-look.fog * 60))
            picture = np.clip(picture * clear + haze * (1 - clear), 0, 255).astype(np.uint8)
            wide = cv2.resize(picture, (sky.ROUND, sky.RISE))
            hills, alpha = sky.skyline(self.seed, self.kind, look.season)
            seen = np.float32(np.exp(-look.fog * 300))
            hills = hills * (ambient * seen) + haze * (1 - seen)
            low = np.clip(hills, 0, 255).astype(np.uint8)
            np.copyto(wide[-sky.HILLS :], low, where=alpha[..., None] > 0.5)
            return np.asarray(wide, np.uint8)

        return self._keep(key, make)

    def _keep(self, key: Any, make: Callable[[], Kept]) -> Kept:
        """What ``make`` gives, made once as long as it is used."""
        if key in self._kept:
            self._kept.move_to_end(key)
        else:
            self._kept[key] = make()
            if len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        kept: Kept = self._kept[key]
        return kept


def join(parts: list[Arrays]) -> Arrays:
    """Several sets of arrays as one."""
    return Arrays(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.alongs for part in parts]),
        np.concatenate([part.ups for part in parts]),
        tuple(key for part in parts for key in part.keys),
        np.concatenate([part.facing for part in parts]),
        np.concatenate([part.reach for part in parts]),
        np.concatenate([part.lamps for part in parts]),
    )
