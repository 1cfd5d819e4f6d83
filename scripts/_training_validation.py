"""How well a network finds places of rendered worlds that it never saw."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from _training_cameras import Image, draw_camera, photograph
from _training_images import Pool
from numpy.typing import NDArray

TOLERANCE = 1
"""Places."""

Describe = Callable[[list[Image]], NDArray[np.float32]]


def accuracy(describe: Describe, pool: Pool, *, cameras: bool, seed: int = 0) -> float:
    """Share of places that find themselves, within ``TOLERANCE`` places, on the other drive.

    Args:
        describe: images to (B, D) descriptors of length 1.
        pool: worlds that the network never saw.
        cameras: whether each traverse is taken by a random camera, else as rendered.
        seed: of the cameras.
    """
    right: list[np.bool_] = []
    for world in range(pool.worlds):
        drives = []  # [drive][sight] -> (P, D)
        for drive in range(2):
            traverses = []
            for sight in range(2):
                rng = np.random.default_rng([seed, world, drive, sight])
                images = list(pool.images[world, :, drive, sight])
                camera = draw_camera(rng)
                if cameras:
                    images = [photograph(image, camera, rng) for image in images]
                traverses.append(describe(images))
            drives.append(traverses)
        for query in drives[0]:
            for reference in drives[1]:
                for a, b in ((query, reference), (reference, query)):
                    found = (a @ b.T).argmax(axis=1)
                    right.extend(np.abs(found - np.arange(len(found))) <= TOLERANCE)
    return float(np.mean(right))
