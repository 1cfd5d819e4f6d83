"""What stands at infinity: clouds and the skyline, as panoramas."""

import cv2
import numpy as np

from amusic_gym.worlds.noise import FIELD, Floats, fractal, generator

ROUND = 4096  # columns of a panorama: 360 degrees
SCALE = 40.0  # texels of the cloud field per height of the clouds
HILLS = 240  # rows of the skyline, from the horizon up
RISE = 512  # rows: from 45 degrees above the horizon down to it


def clouds(seed: int, run: int, cover: float, zenith: Floats, horizon: Floats) -> Floats:
    """(512, 1024, 3) sky of one drive, a quarter as wide as a panorama, with clouds of its own.

    ``cover`` is 0 for clear to 1 for overcast.
    """
    rng = generator(seed, "sky", run)
    field = fractal(1.35, int(rng.integers(4)))
    fine = fractal(1.0, int(rng.integers(4)))
    height = np.linspace(1, 0.02, RISE, dtype=np.float32)[:, None]
    # Clouds lie on a plane overhead: towards the horizon they crowd and flatten.
    rise = height * np.pi / 4
    far = np.minimum(1 / np.tan(rise), 9.0)
    turn = np.arange(0, ROUND, 4)[None, :] / ROUND * 2 * np.pi
    u = (SCALE * far * np.sin(turn) + rng.uniform(0, 512)).astype(np.float32) % FIELD
    v = (SCALE * far * np.cos(turn) + rng.uniform(0, 512)).astype(np.float32) % FIELD
    tall = cv2.remap(field, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    tall = tall + 0.35 * cv2.remap(fine, 3 * u, 3 * v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    tall = tall * np.minimum(1, 5 * height).astype(np.float32)
    thick = np.clip((tall + 2.4 * cover - 1.2) * 1.1, 0, 1)[..., None]
    base = horizon + (zenith - horizon) * (height**0.6)[..., None]
    bright = np.clip(horizon * 1.05 + 12, 0, 255)
    dull = (0.78 - 0.15 * cover) * bright
    shade = np.clip(0.5 + 0.35 * tall, 0, 1)[..., None]
    sky = base * (1 - thick) + (bright * (1 - shade) + dull * shade) * thick
    return np.asarray(sky, np.float32)


def skyline(seed: int, kind: str, season: str) -> tuple[Floats, Floats]:
    """Hills, woods and far roofs: (240, 4096, 3) colour and (240, 4096) alpha, the world's own."""
    rng = generator(seed, "skyline")
    colour = np.zeros((HILLS, ROUND, 3), np.float32)
    alpha = np.zeros((HILLS, ROUND), np.float32)
    rows = np.arange(HILLS)[:, None]
    scale = 1.5 if kind == "rail" else 0.7
    for layer in range(3):
        profile = np.zeros(ROUND)
        for octave in range(1, 9):
            waves = 2**octave
            phase = rng.uniform(0, 2 * np.pi)
            profile += np.cos(np.arange(ROUND) * 2 * np.pi * waves / ROUND + phase) * waves**-0.9
        top = HILLS - scale * (46 - 12 * layer) * np.clip(0.75 + profile * 0.8, 0.1, 3)
        if layer == 2:
            top -= np.abs(rng.normal(0, 4, ROUND))
        tint = np.array([150, 135, 120]) if layer == 0 else np.array([95, 105, 92]) - 14.0 * layer
        if season == "winter":
            tint = tint * 0.5 + np.array([205, 200, 195]) * 0.5
        elif season == "autumn":
            tint = tint * 0.7 + np.array([60, 100, 140]) * 0.3
        inside = rows >= top[None, :]
        texture = 1 + 0.1 * np.tile(fractal(0.8, layer)[:HILLS], (1, ROUND // FIELD))
        np.copyto(colour, tint * texture[..., None], where=inside[..., None], casting="same_kind")
        alpha[inside] = 1
        if kind == "street" and layer == 1:
            _towers(rng, colour, alpha)
    return colour, alpha


def _towers(rng: np.random.Generator, colour: Floats, alpha: Floats) -> None:
    """Blocks and spires on the horizon: landmarks one keeps seeing."""
    for _ in range(60):
        x, wide = int(rng.integers(ROUND)), int(rng.integers(8, 40))
        high = int(rng.integers(20, 70))
        tone = rng.uniform(95, 165) + rng.normal(0, 6, 3)
        columns = slice(x, min(ROUND, x + wide))
        colour[HILLS - high :, columns] = tone
        colour[HILLS - high :: 5, columns] = 0.8 * tone
        alpha[HILLS - high :, columns] = 1
