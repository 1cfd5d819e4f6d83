"""Draws a scene: above what is seen and matched, below what ran, how sure it is, and the route."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.pictures import route, substitutes
from amusic_gym.envs.pictures.canvas import (
    GREY,
    INK,
    LARGE,
    LINE,
    NORMAL,
    PAPER,
    SMALL,
    Box,
    Canvas,
    text_width,
)
from amusic_gym.envs.pictures.scene import Scene
from amusic_gym.utils.colours import (
    CORRECT_COLOUR,
    WRONG_COLOUR,
    ink_on,
    technique_colours,
)

WIDTH, HEIGHT = 960, 540
LEFT_PANEL, RIGHT_PANEL = Box(12, 58, 474, 316), Box(486, 58, 948, 316)
TECHNIQUES = Box(12, 346, 300, 530)
GAUGES = Box(322, 346, 520, 530)
ROUTE = Box(548, 346, 948, 530)
CAPTIONS = 336  # baseline of the lower captions
TALLEST_CHIP, GAP = 34, 6
ONE_COLUMN = 5  # more techniques than this stand in two columns
BAR, BEHIND = "#3F5F8A", "#ECECEC"
CONFIDENT = 4.0
"""Confidence at which its bar is half full; it has no upper end."""


def draw(scene: Scene) -> NDArray[np.uint8]:
    """The picture of a scene, (540, 960, 3) uint8, red-green-blue."""
    canvas = Canvas(WIDTH, HEIGHT)
    colours = list(technique_colours(scene.techniques).values())
    _headline(canvas, scene)
    if scene.query is None:
        substitutes.draw_rows(canvas, scene, colours, LEFT_PANEL)
    else:
        _photograph(canvas, "camera", scene.query, LEFT_PANEL)
    if scene.place is None:
        substitutes.draw_recent(canvas, scene, colours, RIGHT_PANEL)
    else:
        matched = f"matched: place {scene.prediction} (0 to {scene.references - 1})"
        _photograph(canvas, matched, scene.place, RIGHT_PANEL)
    _judge(canvas, scene)
    _techniques(canvas, scene, colours)
    _gauges(canvas, scene)
    route.draw_route(canvas, scene, colours, ROUTE, CAPTIONS)
    return canvas.rgb()


def notice(words: str) -> NDArray[np.uint8]:
    """A picture that only says something, for example that there is no route yet."""
    canvas = Canvas(WIDTH, HEIGHT)
    canvas.text(words, WIDTH // 2, HEIGHT // 2, size=LARGE, anchor="centre", width=WIDTH - 40)
    return canvas.rgb()


def tile(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures of one size side by side and below each other, shrunk to the size of one."""
    if len(pictures) == 1:
        return pictures[0]
    across = int(np.ceil(np.sqrt(len(pictures))))
    height, width = HEIGHT // across, WIDTH // across
    sheet = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    for i, picture in enumerate(pictures):
        down, right = divmod(i, across)
        small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        sheet[down * height : (down + 1) * height, right * width : (right + 1) * width] = small
    return sheet


def _headline(canvas: Canvas, scene: Scene) -> None:
    where = "before the first frame" if scene.frame < 0 else f"frame {scene.frame}"
    if scene.frames is not None:
        where += f" (0 to {scene.frames - 1})"
    taken = canvas.text(where, WIDTH - 12, 24, size=LARGE, anchor="right")
    canvas.text(scene.title, 12, 24, size=LARGE, width=WIDTH - taken - 48)
    canvas.fill(Box(12, 34, WIDTH - 12, 35), LINE)


def _photograph(canvas: Canvas, caption: str, image: NDArray[np.uint8], panel: Box) -> None:
    canvas.text(caption, panel.left, panel.top - 8, colour=GREY)
    canvas.fill(panel, BEHIND)
    canvas.photograph(image, panel)


def _judge(canvas: Canvas, scene: Scene) -> None:
    """Frame the match and say whether it is right, where somebody gave the truth."""
    if scene.correct is None:
        return
    colour = CORRECT_COLOUR if scene.correct else WRONG_COLOUR
    word = "right place" if scene.correct else "wrong place"
    canvas.outline(Box(*RIGHT_PANEL).inside(-5), colour, 5)
    label = Box(RIGHT_PANEL.right - 108, RIGHT_PANEL.top - 24, RIGHT_PANEL.right + 5, 58)
    canvas.fill(label, colour)
    canvas.text(word, label.left + 10, 51, colour=ink_on(colour))


def _techniques(canvas: Canvas, scene: Scene, colours: Sequence[str]) -> None:
    canvas.text(
        "techniques (filled: ran, framed: trusted)", TECHNIQUES.left, CAPTIONS, size=SMALL,
        colour=GREY,
    )  # fmt: skip
    count = len(scene.techniques)
    columns = 1 if count <= ONE_COLUMN else 2
    rows = -(-count // columns)
    height = min(TALLEST_CHIP, (TECHNIQUES.height + GAP) // rows - GAP)
    width = (TECHNIQUES.width + GAP) // columns - GAP
    for i in range(count):
        column, row = divmod(i, rows)
        left = TECHNIQUES.left + column * (width + GAP)
        top = TECHNIQUES.top + row * (height + GAP)
        _chip(canvas, scene, i, colours[i], Box(left, top, left + width, top + height))


def _chip(canvas: Canvas, scene: Scene, i: int, colour: str, box: Box) -> None:
    """A technique's lamp: lit in its colour if it ran, in a black frame if MuSIC trusts it."""
    ran, trusted = scene.ran[i], scene.trusted == i
    ink = ink_on(colour) if ran else GREY
    canvas.fill(box, colour if ran else PAPER)
    canvas.outline(box, INK if trusted else (colour if ran else LINE), 3 if trusted else 1)
    size = NORMAL if box.height >= 24 else SMALL
    baseline = box.top + box.height // 2 + 5
    beside = ["trusted"] if trusted else []
    if ran and scene.milliseconds is not None:
        beside.append(f"{scene.milliseconds[i]:.1f} ms")
    name, right = scene.techniques[i], box.right - 10
    if text_width("   ".join([name, *beside]), size) > box.width - 28:
        del beside[:trusted]  # the frame says it too
    words = "   ".join(beside)
    taken = canvas.text(
        words, right, baseline, size=size, colour=ink, anchor="right", width=box.width * 3 // 5
    )
    canvas.text(name, box.left + 11, baseline, size=size, colour=ink, width=box.width - taken - 28)


def _gauges(canvas: Canvas, scene: Scene) -> None:
    if scene.p_correct is not None:
        value = f"{100 * scene.p_correct:.0f}%"
        _gauge(canvas, 0, "estimated correctness", value, scene.p_correct)
    share = scene.confidence / (abs(scene.confidence) + CONFIDENT)
    _gauge(canvas, 1, "confidence", f"{scene.confidence:.1f}", max(0.0, share))
    _gauge(canvas, 2, "compute (all: 100%)", f"{100 * scene.compute:.0f}%", scene.compute)
    mean = round(min(1.0, scene.compute_mean) * GAUGES.width)
    bar = _bar(2)
    tick = min(GAUGES.left + mean, bar.right - 3)
    canvas.fill(Box(tick, bar.top - 3, tick + 3, bar.bottom + 3), INK)
    words = f"mean {100 * scene.compute_mean:.0f}%"
    if scene.milliseconds is not None:
        words += f",  {scene.milliseconds.sum():.1f} ms now"
    canvas.text(words, GAUGES.left, bar.bottom + 18, size=SMALL, colour=GREY)


def _bar(row: int) -> Box:
    top = GAUGES.top + 8 + 54 * row
    return Box(GAUGES.left, top + 14, GAUGES.right, top + 28)


def _gauge(canvas: Canvas, row: int, name: str, value: str, share: float) -> None:
    """Name and value above a bar that is filled to ``share``."""
    bar = _bar(row)
    canvas.text(name, bar.left, bar.top - 7, size=SMALL, colour=GREY)
    canvas.text(value, bar.right, bar.top - 7, anchor="right")
    canvas.fill(bar, BEHIND)
    canvas.fill(bar._replace(right=bar.left + round(min(1.0, share) * bar.width)), BAR)
