"""The strip of the route: the places found so far, and beneath them which techniques ran."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.pictures.canvas import GREY, INK, LINE, PAPER, SMALL, Box, Canvas, bgr
from amusic_gym.envs.pictures.scene import Scene
from amusic_gym.utils.colours import WRONG_COLOUR

AXIS = 16  # pixels of the numbers below
LANE = 7  # the most pixels that a technique's lane takes
LANES = 64  # the most that all take
LEAST_SPAN = 64
"""Frames across where the route's length is unknown; it doubles when they are full."""


def draw_route(
    canvas: Canvas, scene: Scene, colours: Sequence[str], box: Box, caption: int
) -> None:
    """Place against frame, a dot per frame in the colour of the trusted technique.

    Args:
        canvas: where to draw.
        scene: what to draw.
        colours: (T,) of the techniques.
        box: where on the canvas.
        caption: baseline of the line above.
    """
    span = span_of(scene)
    _caption(canvas, scene, box, caption)
    lane = max(2, min(LANE, LANES // len(scene.techniques)))
    lanes = lane * len(scene.techniques)
    plot = box._replace(bottom=box.bottom - AXIS - lanes - 5)
    canvas.outline(plot, LINE)
    strip = Box(box.left, plot.bottom + 4, box.right, plot.bottom + 4 + lanes)
    canvas.outline(strip.inside(-1), LINE)
    canvas.text("0", box.left, box.bottom - 1, size=SMALL, colour=GREY)
    canvas.text("frame", (box.left + box.right) // 2, box.bottom - 1, size=SMALL, colour=GREY,
                anchor="centre")  # fmt: skip
    canvas.text(str(span - 1), box.right, box.bottom - 1, size=SMALL, colour=GREY, anchor="right")
    if scene.frame < 0:
        return
    x = box.left + across(np.arange(len(scene.trail)), span, box.width)
    _draw_lanes(canvas, scene, colours, strip, lane, span)
    _draw_trail(canvas, scene, colours, plot.inside(1), x)


def span_of(scene: Scene) -> int:
    """Frames across."""
    if scene.frames is not None:
        return max(scene.frames, len(scene.trail))
    span = LEAST_SPAN
    while span < len(scene.trail):
        span *= 2
    return span


def across(frames: NDArray[np.int64], span: int, width: int) -> NDArray[np.int64]:
    """Pixels of frames (n,), 0 to ``width`` − 1."""
    return (frames * (width - 1)) // max(1, span - 1)


def palette(colours: Sequence[str], other: str) -> NDArray[np.uint8]:
    """(T + 1, 3) BGR; the last row, which −1 finds, is for no technique."""
    return np.array([bgr(colour) for colour in (*colours, other)], np.uint8)


def _caption(canvas: Canvas, scene: Scene, box: Box, baseline: int) -> None:
    words = f"place (0 to {scene.references - 1}), and which techniques ran"
    canvas.text(words, box.left, baseline, size=SMALL, colour=GREY, width=box.width)


def _draw_lanes(
    canvas: Canvas, scene: Scene, colours: Sequence[str], strip: Box, lane: int, span: int
) -> None:
    """One lane per technique, coloured where it ran; paler where a pixel holds frames without."""
    ran = np.array(scene.trail.ran, np.bool_)  # (n, T)
    edges = np.arange(strip.width + 1) * span // strip.width  # frames at the pixels' edges
    edges = np.minimum(edges, len(ran))
    begun = np.flatnonzero(edges[:-1] < len(ran))  # pixels that hold frames
    counts = np.concatenate([np.zeros((1, ran.shape[1])), ran.cumsum(axis=0)])  # (n + 1, T)
    last = np.maximum(edges[begun + 1], edges[begun] + 1)
    share = (counts[last] - counts[edges[begun]]) / (last - edges[begun])[:, None]  # (pixels, T)
    colour = palette(colours, PAPER)[:-1, None].astype(np.float64)  # (T, 1, 3)
    shown = np.rint(255.0 + (colour - 255.0) * share.T[..., None]).astype(np.uint8)
    for t in range(shown.shape[0]):
        top = strip.top + t * lane
        canvas.pixels[top : top + lane - 1, strip.left + begun] = shown[t]


def _draw_trail(
    canvas: Canvas, scene: Scene, colours: Sequence[str], plot: Box, x: NDArray[np.int64]
) -> None:
    places = np.array(scene.trail.predictions)
    found = np.flatnonzero(places >= 0)
    if not found.size:
        return
    up = (places[found] * (plot.height - 5)) // max(1, scene.references - 1)
    y = plot.bottom - 3 - up  # whole dots at both ends
    trusted = np.array(scene.trail.trusted)[found]
    canvas.dots(x[found], y, palette(colours, GREY)[trusted], 3, plot)
    if found[-1] == scene.frame:
        canvas.disc(int(x[-1]), int(y[-1]), 5, PAPER, INK)
        canvas.disc(int(x[-1]), int(y[-1]), 2, INK)
    wrong = np.array([scene.trail.correct[i] is False for i in found])
    if wrong.any():  # a cross, so that not only its colour tells
        _crosses(canvas, x[found][wrong], y[wrong], plot)


def _crosses(canvas: Canvas, x: NDArray[np.int64], y: NDArray[np.int64], plot: Box) -> None:
    colour = np.repeat(palette([], WRONG_COLOUR), x.size, axis=0)
    for step in range(-3, 4):
        for down in (step, -step):
            canvas.dots(x + step, y + down, colour, 1, plot)
