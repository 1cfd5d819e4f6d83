"""Contact sheets: all kinds of world under all conditions, rendered or put on an image."""

from __future__ import annotations

import cv2
import numpy as np

from amusic_gym.routes import conditions as image_conditions
from amusic_gym.worlds.conditions import CONDITIONS, REFERENCE
from amusic_gym.worlds.film import Image
from amusic_gym.worlds.views import render
from amusic_gym.worlds.world import World

COLUMNS = (("street", 3, 60.0), ("street", 3, 300.0), ("street", 8, 150.0), ("rail", 3, 300.0),
           ("rail", 7, 800.0), ("corridor", 2, 60.0), ("corridor", 5, 120.0))  # fmt: skip
"""Kind, seed and position in metres of each column."""


def contact_sheet(thumbnail: tuple[int, int] = (160, 120)) -> Image:
    """One row per rendered condition, its name at the left, one column per place of `COLUMNS`."""
    worlds = _worlds()
    rows = []
    for condition in CONDITIONS:
        run = 0 if condition == "day" else 1
        views = [
            render(worlds[kind, seed], position, condition, run=run)
            for kind, seed, position in COLUMNS
        ]
        rows.append(_row(condition, views, thumbnail))
    return np.vstack(rows)


def image_condition_sheet(thumbnail: tuple[int, int] = (160, 120)) -> Image:
    """As :func:`contact_sheet`, of `amusic_gym.routes.conditions` on images rendered by day."""
    worlds = _worlds()
    views = [
        render(worlds[kind, seed], position, REFERENCE, run=0) for kind, seed, position in COLUMNS
    ]
    rows = []
    for name in image_conditions.CONDITIONS:
        condition = image_conditions.Condition.parse(name)
        under = [condition.apply(view, seed=at, frame=0) for at, view in enumerate(views)]
        rows.append(_row(name, under, thumbnail))
    return np.vstack(rows)


def _worlds() -> dict[tuple[str, int], World]:
    return {(kind, seed): World(seed, kind) for kind, seed, _ in COLUMNS}  # type: ignore[arg-type]


def _row(name: str, views: list[Image], thumbnail: tuple[int, int]) -> Image:
    label = np.full((thumbnail[1], 72, 3), 255, np.uint8)
    where = (4, thumbnail[1] // 2 + 5)
    cv2.putText(label, name, where, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    small = [cv2.resize(view, thumbnail, interpolation=cv2.INTER_AREA) for view in views]
    return np.hstack([label, *small])
