"""What the training scripts share: their options, their images, and what they say of themselves."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from _cli import Parser, destination
from _training_images import Pool, PoolSize, make_pool, renderer_digest
from _training_validation import Describe, accuracy

from amusic_gym.utils.threads import one_thread

HELD_OUT_SEED = 1_000_000
"""Added to the seed for the worlds of the validation."""


@dataclass(frozen=True)
class Job:
    """Where a training writes, and how it shows itself; the weights do not depend on it.

    Attributes:
        out: the weights' file.
        resume: whether to go on from checkpoints.
        images: a folder to keep rendered images in, for other trainings of the same renderer.
        progress: whether to show bars and print the validation.
    """

    out: Path
    resume: bool = False
    images: Path | None = None
    progress: bool = True

    def checkpoint(self, stage: str) -> Path:
        """The checkpoint of a stage of the training, beside the weights' file."""
        return self.out.with_name(f"{self.out.stem}.{stage}.checkpoint.safetensors")

    def pools(self, seed: int, learn: PoolSize, held_out: PoolSize) -> tuple[Pool, Pool]:
        """Rendered images to learn from, and others to validate on."""
        return (
            self._pool("learn", learn, seed),
            self._pool("held-out", held_out, seed + HELD_OUT_SEED),
        )

    def _pool(self, name: str, size: PoolSize, seed: int) -> Pool:
        keep = None if self.images is None else self.images / f"{name}-{seed}.safetensors"
        return make_pool(size, seed, keep, progress=self.progress)

    def say(self, text: str) -> None:
        """Print a line, if anything is to be shown."""
        if self.progress:
            print(text, flush=True)

    def clean(self, *stages: str) -> None:
        """Delete the checkpoints of a finished training."""
        for stage in stages:
            self.checkpoint(stage).unlink(missing_ok=True)


def validation(job: Job, describe: Describe, held_out: Pool) -> dict[str, float]:
    """Argmax accuracy on rendered worlds that were not learned from, printed and given."""
    found = {
        "as_rendered": round(accuracy(describe, held_out, cameras=False), 4),
        "random_cameras": round(accuracy(describe, held_out, cameras=True), 4),
    }
    job.say("held-out worlds, share of places found: " + ", ".join(_pair(p) for p in found.items()))
    return found


def _pair(item: tuple[str, float]) -> str:
    return f"{item[0].replace('_', ' ')} {item[1]:.3f}"


def story(script: str, settings: Mapping[str, Any], found: Mapping[str, float]) -> str:
    """How weights were made, for the file that holds them: words, then JSON."""
    about = {"settings": settings, "renderer": renderer_digest(), "held_out": found}
    return (
        f"Made by scripts/{script} with seed {settings['seed']} from rendered worlds and random "
        f"collages, no photographs; not the published weights. {json.dumps(about, sort_keys=True)}"
    )


def command(
    technique: str,
    description: str | None,
    train: Callable[[Job, int], object],
    arguments: list[str] | None,
) -> None:
    """Parse, train on one thread, say where the weights are.

    Args:
        technique: name of the technique on the command line.
        description: of the script; its first line is shown.
        train: trains a job from a seed.
        arguments: of the command line; None: the program's own.
    """
    given = _parser(description).parse_args(arguments)
    with one_thread():
        train(_job(given), given.seed)
    print(f"The weights are in {given.out}; use them with --weights {technique}={given.out}")


def _parser(description: str | None) -> Parser:
    parser = Parser(description=(description or "").splitlines()[0])
    add = parser.add_argument
    add("--out", type=destination, required=True, help="the weights' file, NAME.safetensors")
    add("--seed", type=int, default=0, help="of everything that is drawn (0)")
    add("--resume", action="store_true", help="go on from the checkpoint beside the weights' file")
    add("--images", type=Path, help="a folder that keeps the rendered images for the next training")
    return parser


def _job(given: argparse.Namespace) -> Job:
    if given.out.suffix != ".safetensors":
        raise ValueError(f"--out {given.out} should end in .safetensors; rename it")
    if given.seed < 0:
        raise ValueError(f"--seed is {given.seed}; give a whole number from 0 on")
    return Job(given.out, given.resume, given.images)
