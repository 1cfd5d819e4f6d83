"""Two tracks seen from above, and which places of the one the frames of the other are taken for."""

from pathlib import Path

import numpy as np

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.plots.drawing import GREY, INK, figure_at, percent
from amusic_gym.routes.positions import Positions, in_a_plane
from amusic_gym.utils.colours import CORRECT_COLOUR, WRONG_COLOUR


def draw_matches(bank: ScoreBank, here: Positions, there: Positions, path: str | Path) -> Path:
    """For each technique, whether its row alone ranks a true place first, and a line where not.

    ``here`` are the R positions of the map, ``there`` the Q of the run; ``path`` is a PNG file.
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
            lines = LineCollection(list(ends[~right]), colors=WRONG_COLOUR, linewidths=0.6)
            axes.add_collection(lines)
            for chosen, colour, name in (
                (right, CORRECT_COLOUR, "right"),
                (~right, WRONG_COLOUR, "wrong"),
            ):
                axes.scatter(
                    frames[chosen, 0], frames[chosen, 1], s=7, color=colour, label=name, zorder=3
                )
            axes.set(title=f"{technique}: {percent(right.mean())} right", xlabel="metres")
            axes.set_aspect("equal", "datalim")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return Path(path)
