"""What stands in for photographs where there are none: score rows and the last matches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.scores import floored
from amusic_gym.envs.pictures.canvas import GREY, INK, LINE, SMALL, Box, Canvas
from amusic_gym.envs.pictures.route import palette
from amusic_gym.envs.pictures.scene import Scene

MOST_ROWS = 6
RECENT = 60  # frames of the last matches
LEAST_PLACES = 20  # places that the last matches span at least
FULL_HEIGHT = 5.0  # z-score at the top of a row's panel


def draw_rows(canvas: Canvas, scene: Scene, colours: Sequence[str], box: Box) -> None:
    """The scores of the techniques that ran, against the place; a mark where each one matches."""
    canvas.text("scores of this frame by place", box.left, box.top - 8, colour=GREY)
    canvas.outline(box, LINE)
    shown = list(scene.rows)[:MOST_ROWS]
    if not shown:
        words = "no technique ran" if scene.frame >= 0 else "nothing has run yet"
        canvas.text(words, box.left + 12, box.top + 24, colour=GREY)
        return
    inner = box.inside(6)
    height = inner.height // len(shown)
    for i, technique in enumerate(shown):
        top = inner.top + i * height
        panel = Box(inner.left, top, inner.right, top + height - 4)
        _draw_row(canvas, scene, technique, colours[technique], panel)


def _draw_row(canvas: Canvas, scene: Scene, technique: int, colour: str, panel: Box) -> None:
    row = scene.rows[technique]
    plot = panel._replace(top=panel.top + 14)
    columns, z = peaks(row, plot.width)
    share = np.clip((z + 1.0) / (FULL_HEIGHT + 1.0), 0.0, 1.0)
    y = plot.bottom - 1 - np.rint(share * (plot.height - 1)).astype(np.int64)
    canvas.fill(plot._replace(top=plot.bottom - 1), LINE)
    place = scene.trail.places[-1][technique]
    x = plot.left + int(place * (plot.width - 1) // max(1, row.size - 1))
    canvas.fill(Box(x, plot.top, x + 1, plot.bottom), GREY)
    canvas.line(plot.left + columns, y, colour)
    canvas.disc(x, int(y[np.searchsorted(plot.left + columns, x)]), 4, colour)
    words = f"{scene.techniques[technique]}: place {place}"
    words += " (trusted)" if scene.trusted == technique else ""
    canvas.text(words, plot.left + 2, panel.top + 11, size=SMALL, width=plot.width)


def peaks(row: NDArray[Any], width: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """z-scores of a row (R,), at most ``width`` of them: the best of each pixel's places.

    Returns:
        pixel and z-score, (n,) each.
    """
    scores = floored(np.asarray(row, np.float64))
    deviation = scores.std()
    z = (scores - scores.mean()) / (deviation if deviation > 0.0 else 1.0)
    pixels = np.arange(z.size) * (width - 1) // max(1, z.size - 1)
    starts = np.flatnonzero(np.diff(pixels, prepend=-1))
    return pixels[starts], np.maximum.reduceat(z, starts)


def draw_recent(canvas: Canvas, scene: Scene, colours: Sequence[str], box: Box) -> None:
    """The last matches of every technique in its colour, and in black the place they made."""
    where = "no match yet" if scene.prediction < 0 else f"place {scene.prediction}"
    words = f"{where} (0 to {scene.references - 1}); last matches, black: trusted"
    canvas.text(words, box.left, box.top - 8, colour=GREY, width=box.width)
    canvas.outline(box, LINE)
    fused = np.array(scene.trail.predictions[-RECENT:], np.int64)  # (n,)
    seen = fused >= 0
    if not seen.any():
        return
    low, high = _limits(fused[seen], scene.references)
    plot = Box(box.left + 44, box.top + 8, box.right - 8, box.bottom - 22)
    for place in (low, high):
        level = int(_height(np.array([place]), low, high, plot)[0])
        canvas.text(str(place), plot.left - 6, level + 4, size=SMALL, colour=GREY, anchor="right")
    x = plot.left + 4 + np.arange(fused.size) * (plot.width - 12) // max(1, RECENT - 1)
    places = np.array(scene.trail.places[-RECENT:], np.int64)  # (n, T)
    ran = np.array(scene.trail.ran[-RECENT:], np.bool_)
    near = ran & (places >= low) & (places <= high)
    frames, techniques = np.nonzero(near)
    y = _height(places[near], low, high, plot)
    canvas.dots(x[frames], y, palette(colours, GREY)[techniques], 7, plot)
    inside = seen & (fused >= low) & (fused <= high)
    y = _height(fused[inside], low, high, plot)
    canvas.dots(x[inside], y, palette([INK], INK)[np.zeros(y.size, np.int64)], 3, plot)
    first = len(scene.trail) - fused.size
    canvas.text(f"frame {first}", plot.left, box.bottom - 6, size=SMALL, colour=GREY)
    canvas.text(
        f"{first + RECENT - 1}", plot.right, box.bottom - 6, size=SMALL, colour=GREY, anchor="right"
    )


def _limits(fused: NDArray[np.int64], references: int) -> tuple[int, int]:
    """Places to show: around the last one, as wide as the middle of the recent ones spreads."""
    low, high = (int(q) for q in np.quantile(fused, [0.1, 0.9]))
    low, high = min(low, int(fused[-1])) - 3, max(high, int(fused[-1])) + 3
    spare = max(0, LEAST_PLACES - (high - low))
    low, high = low - spare // 2, high + (spare + 1) // 2
    return max(0, low), min(references - 1, high)


def _height(places: NDArray[np.int64], low: int, high: int, plot: Box) -> NDArray[np.int64]:
    share = (places - low) / max(1, high - low)
    return plot.bottom - 1 - np.rint(share * (plot.height - 1)).astype(np.int64)
