"""The compiled kernel of light: daylight, lamps, headlights, glow and fog."""

import numpy as np

from amusic_gym.kernels.compiling import compiled, inner
from amusic_gym.worlds.noise import Floats
from amusic_gym.worlds.raster import Lens


@inner
def _add_lamps(total: Floats, lamps: Floats, x: np.float32, y: np.float32, z: np.float32) -> None:
    """Light of the lamps within 30 m on a point."""
    for lamp in range(lamps.shape[0]):
        dx, dy, dz = x - lamps[lamp, 0], y - lamps[lamp, 1], z - lamps[lamp, 2]
        square = dx * dx + dy * dy + dz * dz + np.float32(2.0)
        if square < np.float32(900.0):
            for channel in range(3):
                total[channel] += lamps[lamp, 3 + channel] / square


@inner
def _headlights(beam: np.float32, x: np.float32, y: np.float32, z: np.float32) -> np.float32:
    """Light of the vehicle's own lamps on a point: ahead and low."""
    sideways = x / (np.float32(0.35) * z + np.float32(1.0))
    rise = (y + np.float32(0.8)) / (np.float32(0.12) * z + np.float32(0.6))
    lit = beam / (np.float32(1.0) + sideways * sideways * sideways * sideways)
    if rise > 0.0:
        lit /= np.float32(1.0) + rise * rise
    return lit / (np.float32(1.0) + z * z / np.float32(300.0))


@compiled
def light(
    canvas: Floats, inverse_depth: Floats, lamps: Floats, ambient: Floats, glow: float,
    beam: float, fog: Floats, lens: Lens,
) -> None:  # fmt: skip
    """Turn what surfaces reflect into what the camera sees, in place.

    Args:
        canvas: (H, W, 4) float32.
        inverse_depth: (H, W) float32.
        lamps: (N, 6) float32: x, y, z in camera axes, then blue, green, red strength.
        ambient: (3,) float32 light from everywhere.
        glow: how bright surfaces of their own light are.
        beam: strength of the vehicle's headlights.
        fog: (4,) float32: density in 1/metre, blue, green, red.
        lens: (focal length, centre x, centre y) in pixels.
    """
    focal, centre_x, centre_y = lens
    rows, columns = inverse_depth.shape
    total = np.zeros(3, np.float32)
    for y in range(rows):
        for x in range(columns):
            near = inverse_depth[y, x]
            if near <= 0.0:  # the sky comes later
                continue
            z = np.float32(1.0) / near
            across = np.float32((x - centre_x) / focal) * z
            upward = np.float32((centre_y - y) / focal) * z
            own = canvas[y, x, 3] / np.float32(255.0) * np.float32(glow)
            if beam > 0.0:
                own += _headlights(np.float32(beam), across, upward, z)
            for channel in range(3):
                total[channel] = ambient[channel] + own
            _add_lamps(total, lamps, across, upward, z)
            seen = np.float32(np.exp(-fog[0] * z))
            for channel in range(3):
                colour = canvas[y, x, channel] * total[channel]
                canvas[y, x, channel] = colour * seen + fog[1 + channel] * (np.float32(1.0) - seen)
