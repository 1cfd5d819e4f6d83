"""A training as a job: its options, its images, its validation, and what it says of itself."""

import argparse
import importlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.pretraining.cameras import Image, draw_camera, photograph
from amusic_gym.pretraining.pools import Pool, PoolSize, make_pool, renderer_digest
from amusic_gym.utils.threads import one_thread

TECHNIQUES = ("calc", "netvlad")
"""Modules of this package that have a ``Settings`` and a ``train(job, settings)``."""

HELD_OUT_SEED = 1_000_000  # added to the seed for the worlds of the validation
TOLERANCE = 1  # places, in the validation
Describe = Callable[[list[Image]], NDArray[np.float32]]  # images to (B, D) descriptors of length 1


@dataclass(frozen=True)
class TrainingJob:
    """Where a training writes, and how it shows itself; the weights do not depend on it."""

    out: Path  # the weights' file
    resume: bool = False  # whether to go on from checkpoints
    # a folder to keep rendered images in, for other trainings of the same renderer
    images: Path | None = None
    progress: bool = True  # whether to show bars and print the validation

    def checkpoint(self, stage: str) -> Path:
        """The checkpoint of a stage of the training, beside the weights' file."""
        return self.out.with_name(f"{self.out.stem}.{stage}.checkpoint.safetensors")

    def pools(self, seed: int, learn: PoolSize, held_out: PoolSize) -> tuple[Pool, Pool]:
        """Rendered images to learn from, and others to validate on."""

        def pool(name: str, size: PoolSize, seed: int) -> Pool:
            keep = None if self.images is None else self.images / f"{name}-{seed}.safetensors"
            return make_pool(size, seed, keep, progress=self.progress)

        return pool("learn", learn, seed), pool("held-out", held_out, seed + HELD_OUT_SEED)

    def story(
        self, script: str, settings: Mapping[str, Any], describe: Describe, held_out: Pool
    ) -> str:
        """How weights were made and how good they are, for their file: words, then JSON."""
        found = {
            "as_rendered": round(accuracy(describe, held_out, cameras=False), 4),
            "random_cameras": round(accuracy(describe, held_out, cameras=True), 4),
        }
        if self.progress:
            shares = ", ".join(f"{name.replace('_', ' ')} {p:.3f}" for name, p in found.items())
            print(f"held-out worlds, share of places found: {shares}", flush=True)
        about = {"settings": settings, "renderer": renderer_digest(), "held_out": found}
        return (
            f"Made by scripts/{script} with seed {settings['seed']} from rendered worlds and random"
            " collages, no photographs; not the published weights."
            f" {json.dumps(about, sort_keys=True)}"
        )


def accuracy(describe: Describe, pool: Pool, *, cameras: bool) -> float:
    """Share of places that find themselves, within ``TOLERANCE`` places, on the other drive.

    Each traverse is taken by a random camera where ``cameras`` says so, else as rendered.
    """
    right: list[np.bool_] = []
    for world in range(pool.worlds):
        described = {}  # (drive, sight) -> (P, D)
        for drive, sight in product(range(2), range(2)):
            rng = np.random.default_rng([0, world, drive, sight])
            images = list(pool.images[world, :, drive, sight])
            camera = draw_camera(rng)
            if cameras:
                images = [photograph(image, camera, rng) for image in images]
            described[drive, sight] = describe(images)
        for one, other in product(range(2), range(2)):
            pair = described[0, one], described[1, other]
            for query, reference in (pair, pair[::-1]):
                found = (query @ reference.T).argmax(axis=1)
                right.extend(np.abs(found - np.arange(len(found))) <= TOLERANCE)
    return float(np.mean(right))


def add_arguments(parser: argparse.ArgumentParser, destination: Callable[[str], Path]) -> None:
    """Add the options of a training; ``destination`` makes a path to write to of a word."""
    add = parser.add_argument
    add("--out", type=destination, required=True, help="the weights' file, NAME.safetensors")
    add("--seed", type=int, default=0, help="of everything that is drawn (0)")
    add("--resume", action="store_true", help="go on from the checkpoint beside the weights' file")
    add("--images", type=Path, help="a folder that keeps the rendered images for the next training")


def train(technique: str, given: argparse.Namespace) -> None:
    """Train on one thread as the options of `add_arguments` say; print where the weights are.

    Raises:
        FileNotFoundError: if there is nothing to resume.
        ValueError: for a bad option, or a checkpoint of another training.
        KeyboardInterrupt: after a checkpoint.
    """
    if given.out.suffix != ".safetensors":
        raise ValueError(f"--out {given.out} should end in .safetensors; rename it")
    if given.seed < 0:
        raise ValueError(f"--seed is {given.seed}; give a whole number from 0 on")
    module: Any = importlib.import_module(f"amusic_gym.pretraining.{technique}")
    with one_thread():
        module.train(
            TrainingJob(given.out, given.resume, given.images), module.Settings(seed=given.seed)
        )
    print(f"The weights are in {given.out}; use them with --weights {technique}={given.out}")
