"""Frames and traverses of a world: what one calls."""

from collections.abc import Iterator

from amusic_gym.utils.checks import number, whole
from amusic_gym.worlds.camera import aim
from amusic_gym.worlds.conditions import REFERENCE, look_at
from amusic_gym.worlds.drawing import draw
from amusic_gym.worlds.film import Image
from amusic_gym.worlds.world import SPACING, Kind, World

SIZE = (320, 240)  # columns and rows
LARGEST = 4096  # pixels along a side, at most
MOST = 100_000  # places of a traverse, at most


def render(
    world: World,
    position: float,
    condition: str = REFERENCE,
    *,
    size: tuple[int, int] = SIZE,
    run: int = 0,
    frame: int | None = None,
) -> Image:
    """The view from a position of a route.

    Args:
        world: the route.
        position: metres along it, >= 0.
        condition: one of `NAMES`, or several joined by "+"; later ones win.
        size: (columns, rows) in pixels, each 16 to 4096.
        run: number of the drive. Drives differ in sway, clouds, light, parked cars and noise.
        frame: numbers the sway, the noise and what moves; by default from the position.

    Returns:
        (rows, columns, 3) uint8, blue-green-red.

    Raises:
        ValueError: for an unknown condition or a value out of range.
    """
    along = number("position", position, "metres >= 0")
    if along < 0:
        raise ValueError(f"position is {position!r}; give metres >= 0")
    size = check_size(size)
    run = whole("run", run, 0)
    index = whole("frame", round(along * 4) if frame is None else frame, 0)
    look = look_at(condition, world.seed, run, along)
    return draw(world, aim(world, look, run, index, along, size), look, run, index)


def traverse(
    seed: int,
    condition: str = REFERENCE,
    *,
    places: int = 200,
    kind: Kind | None = None,
    size: tuple[int, int] = SIZE,
    run: int = 1,
) -> Iterator[Image]:
    """The frames of one drive, place by place.

    Args:
        seed: of the world.
        condition: one of `NAMES`, or several joined by "+".
        places: 1 to 100000, `SPACING` metres apart.
        kind: of the world; None lets the seed choose.
        size: (columns, rows) in pixels.
        run: number of the drive; 0 is the map's.

    Raises:
        ValueError: for an unknown condition or kind or a value out of range.
    """
    world = World(seed, kind)
    places = check_places(places)
    check_size(size)
    look_at(condition, world.seed, run, 0.0)
    positions = (SPACING[world.kind] * place for place in range(places))
    return (render(world, at, condition, size=size, run=run) for at in positions)


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """(columns, rows) within bounds; refuses others."""
    try:
        columns, rows = size
    except (TypeError, ValueError):
        raise ValueError(f"size is {size!r}; give (columns, rows)") from None
    columns, rows = whole("columns", columns, 16), whole("rows", rows, 16)
    if max(columns, rows) > LARGEST:
        raise ValueError(f"size is {columns}x{rows}; give at most {LARGEST} pixels along a side")
    return columns, rows


def check_places(places: int) -> int:
    """A number of places within bounds; refuses others."""
    places = whole("places", places, 1)
    if places > MOST:
        raise ValueError(f"places is {places}; give at most {MOST}")
    return places
