"""The images behind a bank's frames and places: ``images.json`` beside its scores.

Only who looks at pictures needs them: pages, contact sheets, traces. A bank from scores alone has
no such list.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.bank_files import IMAGES
from amusic_gym.routes.conditions import Change, Condition
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.images import read_image
from amusic_gym.techniques.protocol import Image
from amusic_gym.utils.reading import read_json
from amusic_gym.utils.storage import write_whole


@dataclass(frozen=True)
class ListedImage:
    """An image's file, and the condition that the drive sees it under."""

    path: Path  # absolute
    change: Change | None = None  # None: as it is

    def read(self) -> Image:
        """The image, (H, W, 3) uint8, blue-green-red.

        Raises:
            FileNotFoundError: when it is not there any more.
            ValueError: when it cannot be read.
        """
        image = read_image(self.path)
        return image if self.change is None else self.change.apply(image)


@dataclass(frozen=True)
class BankImages:
    """The images of a bank."""

    query: tuple[ListedImage, ...]  # (Q,) of the frames
    reference: tuple[ListedImage, ...]  # (R,) of the places

    @classmethod
    def of(cls, query: ImageFolder, reference: ImageFolder) -> BankImages:
        """Those of two traverses."""
        return cls(_listed(query), _listed(reference))

    @classmethod
    def load(cls, bank: ScoreBank) -> BankImages | None:
        """Those of a bank on disk; None where it has no list.

        Raises:
            ValueError: for a damaged list, or one of another number of images.
        """
        path = (bank.path or Path()) / IMAGES
        if bank.path is None or not path.is_file():
            return None
        mend = "delete it, or build the bank anew with amusic bank images"
        body = read_json(path, mend)
        try:
            made = cls(*(_read(body[name], bank.path) for name in ("query", "reference")))
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is no list of images ({error!r}); {mend}") from None
        if (len(made.query), len(made.reference)) != (bank.queries, bank.references):
            raise ValueError(f"{path} lists other images than the bank has scores of; {mend}")
        return made

    def save(self, folder: Path) -> None:
        """Write the list to a bank's folder; paths are from there, so that both can move."""
        body = {name: _written(getattr(self, name), folder) for name in ("query", "reference")}
        write_whole(folder / IMAGES, json.dumps(body).encode())

    def frames(self, taken: Sequence[int]) -> BankImages:
        """The same map, driven over the frames ``taken``."""
        return BankImages(tuple(self.query[at] for at in taken), self.reference)


def parse_change(text: str) -> Change:
    """The change whose text this is; refuses another."""
    condition, seed, frame = text.replace(" frame ", " seed ").split(" seed ")
    return Change(Condition.parse(condition), int(seed), int(frame))


def _listed(folder: ImageFolder) -> tuple[ListedImage, ...]:
    paths = (Path(os.path.abspath(path)) for path in folder.paths)
    changes = folder.changes or [None] * len(folder)
    return tuple(map(ListedImage, paths, changes))


def _written(images: Sequence[ListedImage], folder: Path) -> list[list[str]]:
    """[path] or [path, change] of each."""
    names = (Path(os.path.relpath(image.path, folder)).as_posix() for image in images)
    changes = ([str(image.change)] if image.change else [] for image in images)
    return [[name, *change] for name, change in zip(names, changes, strict=True)]


def _read(items: Any, folder: Path) -> tuple[ListedImage, ...]:
    return tuple(
        ListedImage(Path(os.path.normpath(folder / name)), *map(parse_change, change))
        for name, *change in items
    )
