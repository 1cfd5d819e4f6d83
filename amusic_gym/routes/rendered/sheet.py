"""A contact sheet: all kinds of world under all conditions on one picture."""

from __future__ import annotations

import cv2
import numpy as np

from amusic_gym.routes.rendered.conditions import CONDITIONS
from amusic_gym.routes.rendered.film import Image
from amusic_gym.routes.rendered.views import render
from amusic_gym.routes.rendered.world import World

COLUMNS = (("street", 3, 60.0), ("street", 3, 300.0), ("street", 8, 150.0), ("rail", 3, 300.0),
           ("rail", 7, 800.0), ("corridor", 2, 60.0), ("corridor", 5, 120.0))  # fmt: skip
"""Kind, seed and position in metres of each column."""


def contact_sheet(thumbnail: tuple[int, int] = (160, 120)) -> Image:
    """One row per condition, its name at the left, one column per place of `COLUMNS`."""
    worlds = {(kind, seed): World(seed, kind) for kind, seed, _ in COLUMNS}  # type: ignore[arg-type]
    rows = []
    for condition in CONDITIONS:
        label = np.full((thumbnail[1], 72, 3), 255, np.uint8)
        where = (4, thumbnail[1] // 2 + 5)
        cv2.putText(
            label, condition, where, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA
        )
        run = 0 if condition == "day" else 1
        views = [
            render(worlds[kind, seed], position, condition, run=run)
            for kind, seed, position in COLUMNS
        ]
        small = [cv2.resize(view, thumbnail, interpolation=cv2.INTER_AREA) for view in views]
        rows.append(np.hstack([label, *small]))
    return np.vstack(rows)
