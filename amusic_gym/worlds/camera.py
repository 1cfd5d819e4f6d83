"""The camera: where it is in a frame, and how it sees."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_gym.worlds.conditions import Look
from amusic_gym.worlds.noise import generator
from amusic_gym.worlds.world import World

FOCAL = 0.72  # focal length per image width: 70 degrees across


@dataclass(frozen=True)
class ViewCamera:
    """Where the camera is and how it looks."""

    along: float  # metres along the route
    right: float  # metres to the right of the path
    yaw: float  # radians to the right of straight ahead along the path
    pitch: float  # radians upwards
    height: float  # metres over the ground
    size: tuple[int, int]  # (columns, rows) in pixels

    @property
    def lens(self) -> tuple[float, float, float]:
        """Focal length and centre in pixels; small pitch moves the centre."""
        focal = FOCAL * self.size[0]
        return focal, 0.5 * self.size[0] - 0.5, 0.5 * self.size[1] - 0.5 + focal * self.pitch

    def bend(self, world: World, along: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres that the path at ``along`` lies to the right of the line of sight."""
        ahead = along - self.along
        slope = world.heading(self.along) + self.yaw
        return world.path(along) - world.path(np.asarray(self.along)) - self.right - slope * ahead


def aim(
    world: World, look: Look, run: int, frame: int, along: float, size: tuple[int, int]
) -> ViewCamera:
    """The camera of a frame: it sways a little, differently in every drive."""
    rng = generator(world.seed, "sway", run, frame)
    width = world.route.SWAY
    drift = 0.1 * np.sin(along / 37.0 + 2.1 * run) + 0.04 * rng.normal()
    turn = 0.004 * np.sin(along / 23.0 + 1.3 * run) + 0.003 * rng.normal()
    return ViewCamera(
        along=along + 0.12 * rng.normal(),
        right=(look.shift + look.sway * drift) * width,
        yaw=look.yaw + look.sway * turn,
        pitch=look.sway * 0.004 * rng.normal(),
        height=world.route.EYE,
        size=size,
    )
