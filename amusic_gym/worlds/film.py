"""What air, lens and sensor do to a picture: mirrors, flakes, rain, glare, blur, noise."""

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.worlds.camera import FOCAL, ViewCamera
from amusic_gym.worlds.conditions import Look
from amusic_gym.worlds.noise import FIELD, Floats, Generator, fractal

Image = NDArray[np.uint8]


def develop(
    picture: Floats, inverse_depth: Floats, look: Look, camera: ViewCamera, rng: Generator
) -> Image:
    """Mirrors, rain, glare, blur, noise and the range of the sensor."""
    columns = camera.size[0]
    picture = np.ascontiguousarray(picture)
    if look.wet > 0:
        _reflect(picture, inverse_depth, look, camera)
    if look.glow > 0:
        over = np.clip(picture - 150, 0, 200)
        small = cv2.resize(over, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small, (0, 0), max(0.5, columns / 90))
        picture += 0.8 * cv2.resize(small, picture.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    if look.snow > 0:
        _flakes(picture, look, rng)
    if look.glare > 0:
        _glare(picture, inverse_depth, look, rng)
    if look.rain > 0:
        _rain(picture, look, rng)
    if look.blur > 0:
        cv2.GaussianBlur(picture, (0, 0), max(0.3, look.blur * columns / 320), dst=picture)
    if look.noise > 0:
        grain = _grain(rng, *picture.shape[:2])
        picture += (look.noise * (0.5 + np.sqrt(picture[..., 1].clip(0) / 255)) * grain)[..., None]
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _grain(rng: Generator, rows: int, columns: int) -> Floats:
    """(rows, columns) noise of the sensor, deviation 1: a piece of a field, perhaps mirrored."""
    grain = fractal(0.3, int(rng.integers(3)))
    if max(rows, columns) > FIELD:
        grain = np.tile(grain, (1 + rows // FIELD, 1 + columns // FIELD))
    top = int(rng.integers(grain.shape[0] - rows + 1))
    left = int(rng.integers(grain.shape[1] - columns + 1))
    grain = grain[top : top + rows, left : left + columns]
    return grain[:, ::-1] if rng.random() < 0.5 else grain


def _reflect(picture: Floats, inverse_depth: Floats, look: Look, camera: ViewCamera) -> None:
    """Wet ground mirrors what stands above the horizon."""
    horizon = round(camera.lens[2])
    rows = picture.shape[0]
    below = rows - horizon
    if below <= 2 or horizon <= 2:
        return
    mirror = cv2.flip(picture[:horizon], 0)[:below]
    mirror = cv2.blur(mirror, (3, max(3, rows // 16)))
    height = np.arange(1, len(mirror) + 1, dtype=np.float32)[:, None] / (FOCAL * camera.size[0])
    depth_of_ground = height / camera.height
    part = inverse_depth[horizon : horizon + len(mirror)]
    flat = np.abs(part - depth_of_ground) < 0.06 * depth_of_ground + 1e-3
    mix = (look.wet * 0.6 * flat)[..., None].astype(np.float32)
    target = picture[horizon : horizon + len(mirror)]
    target[:] = target * (1 - mix * 0.75) + mirror * mix


def _flakes(picture: Floats, look: Look, rng: Generator) -> None:
    """Snow in the air: most flakes small, some close and blurred."""
    rows, columns = picture.shape[:2]
    count = int(150 * look.snow)
    sizes = np.minimum(rng.pareto(2.5, count) + 0.6, 5) * columns / 320
    layer = np.zeros((rows, columns), np.float32)
    for x, y, size in zip(
        rng.uniform(0, columns, count), rng.uniform(0, rows, count), sizes, strict=True
    ):
        bright = float(0.75 / (0.6 + 0.5 * size))
        cv2.circle(layer, (int(x), int(y)), max(1, int(size)), bright, -1, cv2.LINE_AA)
    cv2.GaussianBlur(layer, (0, 0), max(0.5, columns / 400), dst=layer)
    picture += layer[..., None] * (235 - picture)


def _glare(picture: Floats, inverse_depth: Floats, look: Look, rng: Generator) -> None:
    """Scattered light of a low sun, less where something stands before it."""
    rows, columns = picture.shape[:2]
    x, y = columns * (0.72 + 0.03 * rng.normal()), rows * 0.38
    across = (np.arange(columns, dtype=np.float32) - x) / columns
    down = (np.arange(rows, dtype=np.float32)[:, None] - y) / columns
    far = across * across + down * down
    row, column = min(rows - 1, int(y)), min(columns - 1, int(x))
    strength = look.glare if inverse_depth[row, column] == 0 else 0.35 * look.glare
    spread = strength * (60 / (1 + far * 60) + 150 * np.exp(-far * 400))
    picture += spread[..., None] * np.array([0.55, 0.85, 1.05], np.float32)


def _rain(picture: Floats, look: Look, rng: Generator) -> None:
    """Streaks in the air and drops on the glass."""
    rows, columns = picture.shape[:2]
    layer = np.zeros((rows, columns), np.float32)
    count = int(140 * look.rain)
    slant = rng.normal(0.12, 0.05)
    for x, y, long in zip(rng.uniform(0, columns, count), rng.uniform(0, rows, count),
                          rng.uniform(0.02, 0.09, count) * rows, strict=True):  # fmt: skip
        end = (int(x + slant * long), int(y + long))
        cv2.line(layer, (int(x), int(y)), end, float(20 + 25 * rng.random()), 1, cv2.LINE_AA)
    picture += layer[..., None]
    soft = cv2.blur(picture, (max(3, columns // 24), max(3, rows // 18)))
    mask = np.zeros((rows, columns), np.uint8)
    drops = int(55 * look.rain)
    for x, y, size in zip(rng.uniform(0, columns, drops), rng.uniform(0, rows, drops),
                          rng.uniform(0.006, 0.03, drops) * columns, strict=True):  # fmt: skip
        axes = (max(1, int(size)), max(1, int(1.25 * size)))
        cv2.ellipse(mask, (int(x), int(y)), axes, 0, 0, 360, 255, -1)
    picture[mask > 0] = 0.9 * soft[mask > 0] + 22
