"""``python -m amusic_gym.worlds --out FILE.jpg`` draws the contact sheets of the docs.

One row per condition, its name at the left, one column per place of `COLUMNS`: rendered under the
conditions of this package, or by day with those of `amusic_gym.routes.conditions` put on.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from amusic_gym.routes import conditions as image_conditions
from amusic_gym.worlds import CONDITIONS, REFERENCE, Image, Kind, World, render

COLUMNS: tuple[tuple[Kind, int, float], ...] = (
    ("street", 3, 60.0), ("street", 3, 300.0), ("street", 8, 150.0), ("rail", 3, 300.0),
    ("rail", 7, 800.0), ("corridor", 2, 60.0), ("corridor", 5, 120.0),
)  # fmt: skip
"""Kind, seed and position in metres of each column."""

THUMBNAIL = (160, 120)


def views(worlds: list[World], condition: str, run: int) -> list[Image]:
    """The place of each column under a condition."""
    positions = (position for _, _, position in COLUMNS)
    return [render(w, at, condition, run=run) for w, at in zip(worlds, positions, strict=True)]


def row(name: str, images: list[Image]) -> Image:
    """A name and the images."""
    label = np.full((THUMBNAIL[1], 72, 3), 255, np.uint8)
    where = (4, THUMBNAIL[1] // 2 + 5)
    cv2.putText(label, name, where, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return np.hstack(
        [label, *(cv2.resize(i, THUMBNAIL, interpolation=cv2.INTER_AREA) for i in images)]
    )


def main() -> None:
    """Draw and write a sheet."""
    parser = argparse.ArgumentParser(description="contact sheet of all conditions")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.jpg")
    parser.add_argument(
        "--on-images", action="store_true", help="of the conditions that are put on any image"
    )
    args = parser.parse_args()
    distinct = {(kind, seed): World(seed, kind) for kind, seed, _ in COLUMNS}
    worlds = [distinct[kind, seed] for kind, seed, _ in COLUMNS]
    if args.on_images:
        day = views(worlds, REFERENCE, 0)
        rows = {
            name: [
                image_conditions.Condition.parse(name).apply(view, seed=at, frame=0)
                for at, view in enumerate(day)
            ]
            for name in image_conditions.CONDITIONS
        }
    else:
        rows = {name: views(worlds, name, int(name != REFERENCE)) for name in CONDITIONS}
    sheet = np.vstack([row(name, images) for name, images in rows.items()])
    good, data = cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, 62])
    if not good:
        raise RuntimeError("OpenCV cannot encode the sheet as JPEG")
    args.out.write_bytes(data.tobytes())


if __name__ == "__main__":
    main()
