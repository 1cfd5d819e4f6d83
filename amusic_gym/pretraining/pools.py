"""Images to learn from: rendered worlds under several conditions, and random collages."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from tqdm import tqdm

from amusic_gym import worlds
from amusic_gym.pretraining.cameras import HEIGHT, WIDTH, Image
from amusic_gym.utils.imports import digest_of
from amusic_gym.utils.storage import write_whole
from amusic_gym.worlds import CONDITIONS, KINDS, SPACING, World, render

DRIVES = 2  # drives through each world; they differ in line, sway, light and parked cars
SIGHTS = 2  # conditions under which each drive is rendered, from the very same poses
LINE = "shift"  # the condition that drives on another line: every second world's second drive does


@dataclass(frozen=True)
class PoolSize:
    """How much is rendered."""

    worlds: int = 24  # street, rail and corridor in turn
    places: int = 32  # of each, one after another


@dataclass(frozen=True)
class Pool:
    """Rendered images."""

    images: NDArray[np.uint8]  # (worlds, places, DRIVES, SIGHTS, HEIGHT, WIDTH, 3), BGR

    @property
    def worlds(self) -> int:
        """How many worlds."""
        return len(self.images)

    @property
    def places(self) -> int:
        """How many places of each world."""
        return int(self.images.shape[1])

    def any_image(self, rng: np.random.Generator) -> Image:
        """(HEIGHT, WIDTH, 3) one at random."""
        image: Image = self.images[tuple(rng.integers(self.images.shape[:4]))]
        return image

    def same_pose(self, rng: np.random.Generator) -> tuple[Image, Image]:
        """Two images from one pose, mostly under two conditions."""
        world, place, drive, *sights = rng.integers((*self.images.shape[:4], SIGHTS))
        first, second = self.images[world, place, drive][sights]
        return first, second


def renderer_digest() -> str:
    """SHA-256 of the renderer's source files: other code may draw other images."""
    return digest_of(*sorted(Path(worlds.__file__).parent.glob("*.py")))


def make_pool(
    size: PoolSize, seed: int, keep: Path | None = None, *, progress: bool = True
) -> Pool:
    """Render a pool, or take it from the file where an earlier one was kept.

    The file ``keep`` is read if it holds the pool of this seed, size and renderer, else written.
    """
    about = {"pool": json.dumps([asdict(size), seed, renderer_digest()])}
    if keep is not None and (kept := _kept(keep, about)) is not None:
        return Pool(kept)
    images = np.empty((size.worlds, size.places, DRIVES, SIGHTS, HEIGHT, WIDTH, 3), np.uint8)
    with tqdm(total=size.worlds * DRIVES * SIGHTS, desc="rendering", disable=not progress) as bar:
        for number in range(size.worlds):
            _render_world(images[number], number, seed, bar)
    if keep is not None:
        write_whole(keep, save({"images": images}, about))
    return Pool(images)


def _kept(path: Path, about: dict[str, str]) -> NDArray[np.uint8] | None:
    try:
        with safe_open(path, framework="np") as file:
            same = (file.metadata() or {}) == about
            return np.asarray(file.get_tensor("images")) if same else None
    except (FileNotFoundError, SafetensorError):
        return None


def _render_world(images: NDArray[np.uint8], number: int, seed: int, bar: tqdm) -> None:
    """Fill the images of one world: (places, DRIVES, SIGHTS, HEIGHT, WIDTH, 3)."""
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    world = World(int(rng.integers(2**31)), kind)
    start = float(rng.uniform(0, 200))
    step = SPACING[kind]
    names = sorted(CONDITIONS.keys() - {LINE})
    for drive in range(DRIVES):
        off = rng.uniform(-0.25, 0.25, len(images)) * step
        for sight, name in enumerate(rng.choice(names, SIGHTS, replace=False)):
            condition = f"{name}+{LINE}" if drive and number % 2 else str(name)
            for place in range(len(images)):
                along = start + place * step + off[place]
                images[place, drive, sight] = render(
                    world, along, condition, size=(WIDTH, HEIGHT), run=drive, frame=place
                )
            bar.update()


def collage(rng: np.random.Generator) -> Image:
    """A random picture of overlapping shapes, (HEIGHT, WIDTH, 3).

    Such pictures ("dead leaves") share edges, corners and scales with photographs; features that
    are learned on them transfer (Baradad et al., "Learning to See by Looking at Noise", 2021).
    Each is new, where the rendered worlds are few.
    """
    picture = _surface(rng, HEIGHT, WIDTH)
    sizes = np.exp(rng.normal(np.log(14), 0.8, rng.integers(10, 60)))  # pixels
    for size in sorted(np.minimum(sizes, HEIGHT), reverse=True):  # large ones would hide the rest
        mask = _shape(rng, size)
        high, wide = mask.shape
        top, left = rng.integers(-high // 2, HEIGHT - high // 2), rng.integers(-wide // 2, WIDTH)
        rows = slice(max(top, 0), min(top + high, HEIGHT))
        columns = slice(max(left, 0), min(left + wide, WIDTH))
        inside = mask[
            rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
        ]
        if inside.size:
            surface = _surface(rng, *inside.shape)
            cv2.copyTo(surface, inside, picture[rows, columns])
    return picture


def _shape(rng: np.random.Generator, size: float) -> NDArray[np.uint8]:
    """A mask of a rectangle, an ellipse or a polygon, of 0 and 255."""
    high, wide = (np.maximum(2, size * np.exp(rng.normal(0, 0.6, 2)))).astype(int)
    high, wide = min(int(high), 2 * HEIGHT), min(int(wide), 2 * WIDTH)
    kind = rng.random()
    if kind < 0.5:
        return np.full((high, wide), 255, np.uint8)
    mask = np.zeros((high, wide), np.uint8)
    if kind < 0.65:
        cv2.ellipse(mask, (wide // 2, high // 2), (wide // 2, high // 2), 0, 0, 360, 255, -1)
    else:
        corners = (rng.random((rng.integers(3, 7), 2)) * (wide, high)).astype(np.int32)
        cv2.fillPoly(mask, [cv2.convexHull(corners)], 255)
    return mask


def _surface(rng: np.random.Generator, high: int, wide: int) -> Image:
    """A plain, shaded, striped, chequered or rough surface, (high, wide, 3)."""
    colour = rng.uniform(0, 255, 3) if rng.random() < 0.6 else np.full(3, rng.uniform(0, 255))
    kind = rng.random()
    if kind < 0.4:
        return np.full((high, wide, 3), colour, np.uint8)
    cells = rng.integers(1, 9, 2)
    coarse = colour + rng.normal(0, rng.uniform(5, 60), (*cells, 1))
    how = cv2.INTER_LINEAR if kind < 0.7 else cv2.INTER_NEAREST
    coarse = np.clip(coarse, 0, 255).astype(np.uint8)
    return np.asarray(cv2.resize(coarse, (wide, high), interpolation=how), np.uint8)
