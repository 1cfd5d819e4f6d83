"""Recipes: what a network's file does not say of its input and its output, as TOML beside it.

::

    name = "MixVPR"                  # in tables; default: the file's
    size = [320, 320]                # height, width
    resize = "stretch"               # or "crop", "shorter"
    multiple = 1                     # with "shorter": of what the sides are multiples
    interpolation = "bilinear"       # or "bicubic"
    mean = [0.485, 0.456, 0.406]     # red, green, blue, of 0 to 1; default: ImageNet's
    std = [0.229, 0.224, 0.225]
    output = 0                       # which, where the network gives several: number or name
    metric = "cosine"                # or "dot", "l2"

Only ``size`` must be there.
"""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.network_input import NetworkInput
from amusic_gym.techniques.protocol import Descriptor
from amusic_gym.utils.names import suggest
from amusic_gym.utils.reading import open_file

METRICS = ("cosine", "dot", "l2")
KEYS = (
    *("name", "size", "resize", "multiple", "interpolation", "mean", "std"),
    *("output", "metric"),
)


@dataclass(frozen=True)
class Recipe:
    """A network's input, output and metric."""

    name: str  # in tables
    input: NetworkInput  # how images are prepared
    output: int | str  # number or name of the network's output
    metric: str  # how descriptors are compared
    digest: str  # SHA-256 of the file

    @classmethod
    def read(cls, path: Path, name: str) -> Recipe:
        """A recipe's file; ``name`` is for one without.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it is no TOML, or a value does not fit.
        """
        with open_file(path) as file:
            data = file.read()
        try:
            given = tomllib.loads(data.decode())
            for key in given:
                if key not in KEYS:
                    raise ValueError(suggest("key", key, KEYS))
            return cls._of(given, name, hashlib.sha256(data).hexdigest())
        except (ValueError, TypeError) as error:
            raise ValueError(f"the recipe {path}: {error}") from None

    @classmethod
    def _of(cls, given: dict[str, Any], name: str, digest: str) -> Recipe:
        size = given.get("size")
        if not isinstance(size, list) or len(size) != 2:
            raise ValueError(f"size is {size!r}; give size = [HEIGHT, WIDTH]")
        plain = ("resize", "multiple", "interpolation")
        options: dict[str, Any] = {key: given[key] for key in plain if key in given}
        for key, ours in (("mean", "mean"), ("std", "deviation")):
            if key in given:
                options[ours] = tuple(255 * float(value) for value in given[key])
        output, metric = given.get("output", 0), given.get("metric", "cosine")
        if isinstance(output, bool) or not isinstance(output, int | str):
            raise ValueError(f"output is {output!r}; give a number or a name")
        if metric not in METRICS:
            raise ValueError(suggest("metric", metric, METRICS))
        return cls(
            str(given.get("name", name)), NetworkInput(*size, **options), output, metric, digest
        )

    def finish(self, descriptor: NDArray[Any]) -> Descriptor:
        """What is kept of a network's output (D,): of length 1 for the cosine."""
        values: Descriptor = np.ascontiguousarray(descriptor, np.float32)
        length = float(np.linalg.norm(values))
        return values / np.float32(length) if self.metric == "cosine" and length > 0 else values

    def match(self, query: Descriptor, references: Descriptor) -> NDArray[np.float32]:
        """(B,) similarities."""
        if self.metric == "l2":
            distances: NDArray[np.float32] = np.linalg.norm(references - query, axis=1)
            return -distances
        scores: NDArray[np.float32] = references @ query
        return scores
