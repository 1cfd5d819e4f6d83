"""Techniques and image folders that the tests of extraction share."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from amusic_gym.techniques import Technique


class Tiny(Technique):
    """The grey image itself, of length 1; writes every call into ``log`` if there is one."""

    name = "Tiny"

    def __init__(self, power: float = 1.0, log: Path | None = None) -> None:
        self.power = power
        self.log = log

    def parameters(self):
        return {"power": self.power}

    def describe(self, image):
        if self.log is not None:
            with self.log.open("a") as file:
                file.write("described\n")
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32).ravel() ** self.power
        return grey / np.linalg.norm(grey)


class Raising(Tiny):
    """Raises ``error`` where ``at`` says: describe, describe_query, match or parameters."""

    name = "Raising"

    def __init__(self, error, at):
        super().__init__()
        self.error, self.at = error, at

    def parameters(self):
        return {"error": repr(self.error), "at": self.at, **self._give("parameters", {})}

    def describe(self, image):
        return self._give("describe", super().describe(image))

    def describe_query(self, image):
        return self._give("describe_query", super().describe(image))

    def match(self, query, references):
        return self._give("match", super().match(query, references))

    def _give(self, at, value):
        if at != self.at:
            return value
        if isinstance(self.error, BaseException):
            raise self.error
        return self.error(value)


class TwoSided(Tiny):
    """Describes queries in another way, and in another shape."""

    name = "TwoSided"

    def describe_query(self, image):
        descriptor = super().describe(image)
        return np.stack([descriptor, descriptor[::-1]])

    def match(self, query, references):
        return (references @ query.T).max(axis=1)


class Signalling(Tiny):
    """Sends a signal at the first image after ``after`` others, once if it has a ``marker``.

    It goes to its own process, to the parent, or to the whole group as Ctrl-C does.
    """

    name = "Tiny"  # in tables; scores must be those of Tiny

    def __init__(self, number, *, whom="self", marker=None, after=0, log=None):
        super().__init__(log=log)
        self.number, self.whom, self.marker, self.after = number, whom, marker, after

    def describe(self, image):
        count = len(self.log.read_text().split()) if self.log and self.log.exists() else 0
        if count >= self.after and not (self.marker and self.marker.exists()):
            if self.marker:
                self.marker.touch()
            if self.whom == "group":
                os.killpg(0, self.number)
            else:
                os.kill(os.getppid() if self.whom == "parent" else os.getpid(), self.number)
        return super().describe(image)


class FromEnvironment(Signalling):
    """What a test asks for by environment variables, for scripts."""

    def __init__(self):
        marker = os.environ.get("TEST_MARKER")
        super().__init__(
            signal.Signals[os.environ["TEST_SIGNAL"]],
            whom=os.environ.get("TEST_WHOM", "self"),
            marker=Path(marker) if marker else None,
            after=int(os.environ["TEST_AFTER"]),
            log=Path(os.environ["TEST_LOG"]),
        )


@dataclass(frozen=True)
class Shard:
    """Work of a test: twice the technique's power times a number, or an error."""

    number: int
    error: tuple = ()
    key: str = ""
    size: int = 1

    def run(self, technique, advance=lambda done: None):
        if self.error:
            raise self.error[0](*self.error[1:])
        advance(self.size)
        return np.full(2, technique.power * self.number, np.float32)


class UnpicklableError(Exception):
    def __init__(self, one, two):
        super().__init__(one)


def make_images(folder: Path, count: int, seed: int = 0, size: tuple[int, int] = (6, 8)) -> Path:
    """A folder of ``count`` different small images."""
    folder.mkdir(parents=True)
    pixels = np.random.default_rng(seed)
    for number in range(count):
        image = pixels.integers(1, 255, (*size, 3), dtype=np.uint8)
        assert cv2.imwrite(str(folder / f"{number:04d}.png"), image)
    return folder
