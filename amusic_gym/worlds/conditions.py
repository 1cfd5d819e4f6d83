"""Under which conditions a route is driven: what each changes, one entry each."""

from dataclasses import dataclass, replace
from typing import Any

from amusic_gym.utils.names import suggest
from amusic_gym.worlds.noise import generator
from amusic_gym.worlds.paint import Colour


@dataclass(frozen=True)
class Look:
    """All that a drive has of its own; the defaults are a bright day."""

    season: str = "summer"  # "summer", "autumn" or "winter"
    sun: float = 0.25  # how much brighter a sunlit side is than a shaded one, 0-1
    side: float = 0.5  # where the sun stands, -1 left to 1 right
    shadow: float = 0.3  # how dark shadows on the ground are, 0-1
    ambient: Colour = (1.0, 1.0, 1.0)  # light from everywhere (blue, green, red)
    glow: float = 0.0  # brightness of lamps and lit windows
    lamps: float = 0.0  # brightness of the pools of light under lamps
    beam: float = 0.0  # the vehicle's headlights
    fog: float = 0.0016  # density in 1/metre
    haze: Colour = (205, 200, 192)  # colour of fog and of distance
    cover: float = 0.5  # clouds, 0-1
    zenith: Colour = (205, 150, 105)  # colour of the sky above
    horizon: Colour = (225, 215, 200)  # and at the horizon
    shift: float = 0.0  # metres the camera drives to the right of the reference's line
    yaw: float = 0.0  # radians it looks to the right
    sway: float = 1.0  # how far the camera strays from its line, 1 as on the map's drive
    crowd: float = 0.0  # people and cars on the move, 0 none to 1 many
    rain: float = 0.0  # streaks and drops, 0-1
    snow: float = 0.0  # falling flakes, 0-1
    glare: float = 0.0  # of a low sun ahead, 0-1
    wet: float = 0.0  # mirroring ground, 0-1
    noise: float = 1.5  # of the sensor, grey levels
    blur: float = 0.0  # of the lens, pixels at 320 columns


GREY: dict[str, Any] = {"zenith": (190, 180, 172), "horizon": (205, 202, 200)}
DARK: dict[str, Any] = {"zenith": (26, 15, 10), "horizon": (40, 28, 26)}

CONDITIONS: dict[str, dict[str, Any]] = {
    "day": {},
    "summer": {"sun": 0.5, "shadow": 0.62, "cover": 0.15, "side": -0.8,
               "ambient": (0.98, 1.02, 1.06), "zenith": (215, 135, 75), "sway": 3.0},
    "winter": {"season": "winter", "sun": 0.1, "shadow": 0.1, "cover": 0.85, "fog": 0.006,
               "ambient": (1.02, 0.97, 0.93), "haze": (215, 212, 208), "sway": 2.5, "snow": 1.0,
               **GREY},
    "autumn": {"season": "autumn", "sun": 0.45, "shadow": 0.5, "side": -0.9, "cover": 0.7,
               "ambient": (0.84, 0.92, 1.0), "fog": 0.005, "sway": 3.0},
    "night": {"sun": 0.0, "shadow": 0.0, "ambient": (0.085, 0.06, 0.05), "glow": 1.15, "lamps": 7.0,
              "beam": 0.45, "haze": (30, 22, 20), "noise": 6.0, "blur": 0.8, "cover": 0.4,
              "sway": 1.5, **DARK},
    "fog": {"sun": 0.02, "shadow": 0.05, "fog": 0.085, "cover": 1.0, "haze": (196, 194, 190),
            "ambient": (0.9, 0.9, 0.9), "noise": 2.5, "sway": 2.0, **GREY},
    "rain": {"sun": 0.0, "shadow": 0.05, "fog": 0.012, "rain": 1.0, "wet": 0.8, "cover": 1.0,
             "glow": 0.3, "ambient": (0.66, 0.63, 0.6),
             "haze": (150, 146, 142), "blur": 0.8, "sway": 3.0,
             "zenith": (140, 132, 125), "horizon": (165, 160, 155)},
    "dusk": {"sun": 0.7, "shadow": 0.7, "side": 1.6, "ambient": (0.38, 0.41, 0.56), "glow": 0.8,
             "lamps": 1.5, "cover": 0.45, "haze": (110, 130, 175), "zenith": (120, 75, 60),
             "horizon": (90, 150, 225), "noise": 4.0, "glare": 1.0, "sway": 3.0},
    "shift": {"shift": 1.3, "yaw": 0.06, "sway": 2.0},
    "crowd": {"crowd": 1.0, "sun": 0.3, "cover": 0.6, "sway": 2.5},
}  # fmt: skip
"""What each condition changes in a `Look`; join several with "+", as in ``"winter+night"``."""

STRETCHES = "changing"  # the condition that drives through stretches of others
REFERENCE = "day"  # the condition of the map
STRETCH_METRES = 60.0

NAMES: tuple[str, ...] = (*CONDITIONS, STRETCHES)


def parts_of(condition: str) -> tuple[str, ...]:
    """The registered names that ``condition`` joins with "+"; refuses others."""
    names = tuple(condition.split("+")) if isinstance(condition, str) else (condition,)
    for name in names:
        if name not in NAMES:
            raise ValueError(suggest("condition", name, NAMES))
    return names


def look_at(condition: str, seed: int, run: int, position: float) -> Look:
    """How the world looks at a position of a drive, in metres; every drive differs a little.

    ``condition`` is one or more of `NAMES`, joined by "+"; later ones win. Only "changing" depends
    on the position.

    Raises:
        ValueError: for an unknown condition.
    """
    look = _vary(Look(), seed, run)
    for name in parts_of(condition):
        if name == STRETCHES:
            name = stretch_at(seed, run, position)
        look = replace(look, **CONDITIONS[name])
    return look


def stretch_at(seed: int, run: int, position: float) -> str:
    """The condition that "changing" has at a position: another one every 60 to 120 metres."""
    names = tuple(CONDITIONS)
    order: list[str] = []
    for round_ in range(int(position / (STRETCH_METRES * len(names))) + 1):
        order.extend(generator(seed, "stretches", run, round_).permutation(names))
    return str(order[int(position / STRETCH_METRES)])


def _vary(look: Look, seed: int, run: int) -> Look:
    """Two days never have quite the same light."""
    rng = generator(seed, "light", run)
    scale = 1 + rng.normal(0, 0.05)
    blue, green, red = scale * (1 + rng.normal(0, 0.02, 3))
    return replace(
        look,
        sun=look.sun * rng.uniform(0.7, 1.3),
        side=look.side + rng.normal(0, 0.15),
        cover=float(rng.uniform(0.3, 0.6)),
        ambient=(float(blue), float(green), float(red)),
    )
