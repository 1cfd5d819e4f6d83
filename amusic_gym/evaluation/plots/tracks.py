"""Two tracks seen from above, and which places of the one the frames of the other are taken for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.plots.drawing import GREY, INK, figure_at, percent
from amusic_gym.routes.positions import Positions, in_a_plane
from amusic_gym.utils.colours import CORRECT_COLOUR, WRONG_COLOUR


def draw_matches(bank: ScoreBank, here: Positions, there: Positions, path: str | Path) -> Path:
    """For each technique, a line from each frame to the place that its row alone ranks first.

    Args:
        bank: scores and ground truth.
        here: R positions of the map.
        there: Q positions of the run.
        path: the PNG file.
    """
    from matplotlib.collections import LineCollection

    places, frames = in_a_plane(here, there)  # (R, 2), (Q, 2)
    count = len(bank.techniques)
    columns = min(2, count)
    rows = -(-count // columns)
    with figure_at(path, 4.6 * columns, 4.2 * rows) as figure:
        for t, technique in enumerate(bank.techniques):
            best = np.array([int(bank.row(t, query).argmax()) for query in range(bank.queries)])
            right = bank.truth.correct(best)
            axes = figure.add_subplot(rows, columns, t + 1)
            axes.plot(*places.T, color=GREY, linewidth=2.5, label="map")
            axes.plot(*frames.T, color=INK, linewidth=0.8, label="run")
            ends = np.stack([frames, places[best]], axis=1)  # (Q, 2, 2)
            for chosen, colour, name in (
                (~right, WRONG_COLOUR, "wrong"),
                (right, CORRECT_COLOUR, "right"),
            ):
                lines = LineCollection(
                    list(ends[chosen]), colors=colour, linewidths=0.6, label=name
                )
                axes.add_collection(lines)
            axes.set(title=f"{technique}: {percent(right.mean())} right", xlabel="metres")
            axes.set_aspect("equal", "datalim")
            if t == 0:
                axes.legend(loc="best")
    return Path(path)
