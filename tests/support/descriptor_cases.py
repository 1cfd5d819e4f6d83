"""Descriptors of small routes, in every layout in which others keep them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
from image_cases import encoded
from numpy.typing import NDArray

PLACES, SIZE = 12, 16

NAMES = tuple(f"img{number}.jpg" for number in range(1, PLACES + 1))
"""Not padded: img10 comes before img2 by letters."""


def made(seed: int = 0, count: int = PLACES, size: int = SIZE) -> NDArray[np.float32]:
    """(count, size) float32 of length 1, different ones."""
    vectors = np.random.default_rng(seed).normal(size=(count, size))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def runs(seed: int = 0, noise: float = 0.05) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Descriptors of a map, and of a run at the same places."""
    places = made(seed)
    frames = places + noise * np.random.default_rng(seed + 1).normal(size=places.shape)
    frames /= np.linalg.norm(frames, axis=1, keepdims=True)
    return places, frames.astype(np.float32)


def write_images(folder: Path, names: Sequence[str] = NAMES) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        noise = np.random.default_rng(abs(hash((folder.name, name))) % 2**32)
        (folder / name).write_bytes(
            encoded(".jpg", image=noise.integers(0, 256, (12, 16, 3), dtype=np.uint8))
        )
    return folder


def write_npy(path: Path, array: NDArray[np.generic]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, array)
    return path


def write_list(path: Path, names: Sequence[str]) -> Path:
    path.write_text("".join(f"{name}\n" for name in names), "utf-8")
    return path


def write_h5(
    path: Path, vectors: NDArray[np.generic], names: Sequence[str] = NAMES, below: str = ""
) -> Path:
    """As hloc's extract_features writes it; adds to a file that is there."""
    with h5py.File(path, "a", libver="latest") as file:
        for name, vector in zip(names, vectors, strict=True):
            group = file.create_group(below + name)
            group.create_dataset("global_descriptor", data=vector)
            group.create_dataset("image_size", data=np.array([16, 12]))
    return path


def by_letters(vectors: NDArray[np.generic]) -> NDArray[np.generic]:
    """The rows in the order in which glob and sorted give their images."""
    return vectors[np.argsort(NAMES)]
