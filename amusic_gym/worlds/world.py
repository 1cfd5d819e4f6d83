"""A route: its path, its blocks and all that is kept between frames."""

from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import suggest
from amusic_gym.worlds import corridor, ground, railway, sky, street
from amusic_gym.worlds.conditions import Look
from amusic_gym.worlds.ground import BLOCK, GroundPlan, Texture
from amusic_gym.worlds.layout import Block, Key, Things
from amusic_gym.worlds.noise import generator
from amusic_gym.worlds.textures import Levels, pyramid, texture

Kind = Literal["street", "rail", "corridor"]
KINDS: tuple[Kind, ...] = ("street", "rail", "corridor")

ROUTES: dict[str, ModuleType] = {"street": street, "rail": railway, "corridor": corridor}
"""What each kind is made of: a module with the same names as the others."""

SPACING = {kind: float(route.SPACING) for kind, route in ROUTES.items()}  # metres between places
AHEAD = 6  # blocks drawn from the camera's own one on
Kept = TypeVar("Kept")


class Store:
    """The last things that were made, ``limit`` of them, by name, each as long as it is used."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._kept: OrderedDict[Any, Any] = OrderedDict()

    def get(self, key: Any, make: Callable[[], Kept]) -> Kept:
        """What ``make`` gives, or once gave."""
        if key in self._kept:
            self._kept.move_to_end(key)
        else:
            self._kept[key] = make()
            if len(self._kept) > self._limit:
                self._kept.popitem(last=False)
        kept: Kept = self._kept[key]
        return kept


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
        self.route: Any = ROUTES[self.kind]
        self._textures = Store(400)  # about 0.3 MB each
        self._store = Store(96)  # blocks, maps, skies and the like
        rng = generator(self.seed, "path")
        bends = self.route.BENDS  # (amplitude, length) in metres
        self._waves = [(a, 2 * np.pi / b, rng.uniform(0, 2 * np.pi)) for a, b in bends]

    def path(self, along: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres the path lies to the right of a straight line, at metres along it."""
        waves = [a * np.sin(w * along + phase) for a, w, phase in self._waves]
        return np.asarray(sum(waves), np.float64)

    def heading(self, along: float) -> float:
        """Slope of the path, in radians (small)."""
        return float(sum(a * w * np.cos(w * along + phase) for a, w, phase in self._waves))

    def texture(self, key: Key, season: str) -> Levels:
        """All levels of a texture and the table of them (see `textures.pyramid`)."""
        return self._textures.get((key, season), lambda: texture(self.seed, key, season))

    def block(self, number: int) -> Block:
        """What stands in a block, but for what goes and comes."""
        build: Callable[[], Block] = partial(self.route.build, self.seed, number)
        return self._store.get(("block", number), build)

    def _parked(self, number: int, run: int) -> Block:
        """What stands in a block on one drive only: cars at the kerb of a street."""

        def make() -> Block:
            if self.kind == "street":
                return street.parked(self.seed, number, run)
            return Block(self.seed, number * BLOCK)

        return self._store.get(("parked", number, run), make)

    def things(self, first: int, run: int) -> Things:
        """Everything that stands in the blocks from ``first`` on, in one set of arrays."""

        def make() -> Things:
            numbers = range(first, first + AHEAD)
            stay, go = map(self.block, numbers), (self._parked(number, run) for number in numbers)
            return Things.of(*stay, *go)

        return self._store.get(("things", first, run), make)

    def ground(self, first: int, look: Look, run: int) -> Levels:
        """Map of the ground from block ``first`` on."""
        season, side, dark = look.season, round(look.side, 2), round(look.shadow, 2)
        if self.kind == "corridor":
            season, side, dark, run = "summer", 0.0, 0.0, 0

        def plan(number: int) -> Texture:
            draw: Callable[[], GroundPlan] = partial(self.route.plan, self.seed, number, season)
            base = self._store.get(("plan", number, season), lambda: draw().texture())
            if not dark:
                return base
            shadows = self.block(number).cast(side) + self._parked(number, run).cast(side)
            return ground.shaded(base, shadows, dark)

        def make() -> Levels:
            numbers = range(first, first + AHEAD)
            light = (season, side, dark, run)
            maps = [self._store.get(("map", n, *light), partial(plan, n)) for n in numbers]
            return pyramid(np.concatenate(maps))

        return self._store.get(("ground", first, season, side, dark, run), make)

    def ceiling(self, first: int) -> Levels:
        """Map of a corridor's ceiling from block ``first`` on."""

        def make() -> Levels:
            numbers = range(first, first + AHEAD)
            plans = [ground.ceiling(self.seed, number).texture() for number in numbers]
            return pyramid(np.concatenate(plans))

        return self._store.get(("ceiling", first), make)

    def clouds(self, look: Look, run: int) -> NDArray[np.uint8]:
        """(512, 4096, 3) panorama of the sky with the skyline before it."""
        air = (look.ambient, look.cover, look.zenith, look.horizon, look.haze, look.fog)

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

        return self._store.get(("sky", look.season, *air, run), make)
