"""The demo's rendered routes: image folders, and the score banks of all techniques on them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from amusic_gym.bank import ScoreBank
from amusic_gym.extraction import Cache, extract
from amusic_gym.routes.images import read_image
from amusic_gym.routes.rendered import Kind, render_folders

TECHNIQUES = ("hog", "calc", "netvlad", "cohog")
TOLERANCE = 1
PLACES = 100


class Drives(NamedTuple):
    """A world, and the conditions of the drives through it."""

    kind: Kind
    seed: int
    conditions: tuple[str, ...]


DRIVES = (
    Drives("street", 4_000, ("winter+night", "fog+shift")),
    Drives("rail", 4_001, ("winter+rain", "night+shift")),
    Drives("corridor", 4_002, ("night+crowd", "shift+crowd")),
)


def rendered_banks(out: Path, say: Callable[[str], None]) -> list[ScoreBank]:
    """Render the drives to ``out/images``, run the techniques, and keep the banks.

    What is there from an earlier call is not done again.
    """
    banks = []
    with Cache(out / "cache") as cache:
        for drives in DRIVES:
            images = out / "images" / drives.kind
            say(f"rendering a {drives.kind} route: {', '.join(('day', *drives.conditions))}")
            render_folders(
                images, drives.conditions, seed=drives.seed, places=PLACES, kind=drives.kind
            )
            for condition in drives.conditions:
                name = f"{drives.kind}-{condition}"
                say(f"running {', '.join(TECHNIQUES)} on {name}")
                bank = extract(
                    images / "reference",
                    images / condition,
                    TECHNIQUES,
                    tolerance=TOLERANCE,
                    cache=cache,
                    name=name,
                    out=out / "banks" / name,
                )
                banks.append(bank)
    return banks


def contact_sheet(out: Path) -> Path:
    """A picture of some places of every drive, the map above."""
    columns = []
    for drives in DRIVES:
        images = out / "images" / drives.kind
        for place in (PLACES // 4, 3 * PLACES // 4):
            shown = [
                read_image(sorted((images / folder).glob("*.jpg"))[place])
                for folder in ("reference", *drives.conditions)
            ]
            columns.append(np.concatenate(shown))
    path = out / "rendered.jpg"
    sheet = np.concatenate(columns, axis=1)
    small = cv2.resize(sheet, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    path.write_bytes(cv2.imencode(".jpg", small)[1].tobytes())
    return path
