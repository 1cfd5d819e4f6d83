"""Drawing without global state: figures that write themselves, labels that keep clear."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.utils.storage import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DOTS_PER_INCH = 160
INK, GREY = "#222222", "#8A8A8A"
NOTE_RADII = (7, 12, 19, 28, 39)  # points between a point and the edge of its label
NOTE_DIRECTIONS = 16
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 11.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.7,
    "hatch.linewidth": 0.6,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "text.parse_math": False,  # names may hold "$"
}

Note = tuple[float, float, str, str]  # x, y, text, colour


@contextmanager
def figure_at(path: str | Path, width: float, height: float) -> Iterator[Figure]:
    """A figure of so many inches that is drawn and written to `path` when the block ends.

    The end of `path` says what kind of file it is: PNG or PDF.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(), warnings.catch_warnings():
        matplotlib.rcdefaults()  # a user's own style would break colours that carry meaning
        matplotlib.rcParams.update(STYLE)
        warnings.filterwarnings("ignore", "Glyph .* missing")  # names in scripts the font lacks
        figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        yield figure
        image = io.BytesIO()
        figure.savefig(image, format=Path(path).suffix[1:], dpi=DOTS_PER_INCH)
    write_whole(path, image.getvalue())


def only(values: set[str], what: str, given: str) -> str:
    """The one value that all inputs must share."""
    if len(values) != 1:
        named = ", ".join(sorted(values)) or "none"
        raise ValueError(f"one {what} per figure, but the {given} hold {named}; draw one each")
    return values.pop()


def percent(share: float, _: float | None = None) -> str:
    """A share as a tick label (Matplotlib passes the tick's number too)."""
    return f"{100 * share:.3g}%"


def place_notes(
    figure: Figure, axes: Axes, notes: Sequence[Note], points: Sequence[tuple[float, float]]
) -> None:
    """Write each note beside its point, where it covers the least of points, lines and notes."""
    figure.draw_without_rendering()  # lays the axes out, so that data have a place on the page
    figure.set_layout_engine("none")
    to_page: Callable[[Any], NDArray[np.float64]] = axes.transData.transform
    blocked = _drawn(axes, points)
    boxes: list[NDArray[np.float64]] = []
    dot = figure.dpi / 72.0  # pixels per point
    for x, y, words, colour in _merge(notes, to_page, 9 * dot):
        note = axes.annotate(
            words,
            (x, y),
            (0, 0),
            textcoords="offset points",
            ha="center",
            va="center",
            color=colour,
            fontsize=8,
            zorder=6,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkB": 4},
        )
        extent = note.get_window_extent()
        half = np.array([extent.width, extent.height]) / 2.0 + 1.5 * dot
        home = to_page((x, y))
        options = []
        for radius, centre in _places_around(home, half, dot):
            box = np.array([centre - half, centre + half])
            cost = _clutter(box, blocked, boxes, axes.get_window_extent().get_points())
            options.append((cost + 0.6 * radius, radius, box))
        _, radius, box = min(options, key=lambda option: option[0])
        boxes.append(box)
        note.set_position(tuple((box.mean(axis=0) - home) / dot))
        if note.arrow_patch is not None:  # a note beside its point needs no line to it
            note.arrow_patch.set_visible(radius > NOTE_RADII[0])


def _drawn(axes: Axes, points: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """Pixels (n, 2) that notes should not cover: the points, and the lines in small steps."""
    taken = [axes.transData.transform(point)[None] for point in points]
    for line in axes.lines:
        path = line.get_transform().transform_path(line.get_path()).interpolated(24)
        taken.append(np.asarray(path.vertices))
    return np.concatenate([np.zeros((0, 2)), *taken])


def _places_around(
    home: NDArray[np.float64], half: NDArray[np.float64], dot: float
) -> Iterator[tuple[float, NDArray[np.float64]]]:
    """Centres for a box of half size `half` around a point, nearest first, with their radius."""
    for radius in NOTE_RADII:
        for angle in np.arange(NOTE_DIRECTIONS) * (2 * np.pi / NOTE_DIRECTIONS):
            towards = np.array([np.cos(angle), np.sin(angle)])
            yield radius, home + towards * (radius * dot + half * np.abs(towards))


def _clutter(
    box: NDArray[np.float64],
    blocked: NDArray[np.float64],
    boxes: Sequence[NDArray[np.float64]],
    frame: NDArray[np.float64],
) -> float:
    """How badly a label's box [[left, bottom], [right, top]] covers what is there already."""
    covered = ((blocked > box[0]) & (blocked < box[1])).all(axis=1).sum()
    over = sum(bool(((box[0] < other[1]) & (other[0] < box[1])).all()) for other in boxes)
    outside = (box[0] < frame[0]).any() or (box[1] > frame[1]).any()
    return 6.0 * float(covered) + 400.0 * over + 1000.0 * bool(outside)


def _merge(
    notes: Sequence[Note], to_page: Callable[[Any], NDArray[np.float64]], near: float
) -> list[Note]:
    """Notes of one colour whose points lie on top of each other, as one: "λ 0.01, 0.03"."""
    merged: list[Note] = []
    for note in notes:
        for i, other in enumerate(merged):
            apart = np.abs(to_page(note[:2]) - to_page(other[:2])).max()
            if note[3] == other[3] and apart < near:
                merged[i] = (*other[:2], f"{other[2]}, {note[2].removeprefix('λ ')}", other[3])
                break
        else:
            merged.append(note)
    return merged
