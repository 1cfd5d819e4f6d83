"""The reliability diagram of several kinds of drives, one curve each, above the frames per bin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym.evaluation.plots.drawing import GREY, figure_at

COLOURS = ("#0072B2", "#D55E00")
MARKS = ("o", "s")
LEAST = 0.7  # frames at which the bars begin, on a logarithmic scale
FEW = 30
"""Bins of fewer frames are hollow: their share says little."""


def draw_reliability(
    curves: Mapping[str, Mapping[str, Sequence[Any]]], title: str, path: Path
) -> Path:
    """Draw share right against mean p̂; no intervals, as frames of one drive are not independent.

    Args:
        curves: name → ``predicted``, ``observed`` (None in empty bins) and ``counts``, each (B,);
            at most two.
        title: of the figure.
        path: the PNG to write.
    """
    with figure_at(path, 6.4, 7.0) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
        upper.plot([0, 1], [0, 1], color=GREY, linestyle="--", linewidth=1, label="perfect")
        for i, (name, curve) in enumerate(curves.items()):
            look: dict[str, Any] = {"color": COLOURS[i], "marker": MARKS[i]}
            counts = np.array(curve["counts"])
            points = np.array([curve["predicted"], curve["observed"]], float)  # (2, B), nan: empty
            upper.plot(*points[:, counts > 0], label=f"{name}, {counts.sum()} frames", **look)
            few = points[:, (counts > 0) & (counts < FEW)]
            upper.plot(*few, linestyle="none", markerfacecolor="white", **look)
            width = 0.8 / counts.size / len(curves)
            middles = (np.arange(counts.size) + 0.5) / counts.size
            aside = (i - (len(curves) - 1) / 2.0) * width
            bars = lower.bar(middles + aside, counts, width, color=COLOURS[i])
            words = [str(count or "") for count in counts]
            lower.bar_label(bars, words, padding=2, rotation=90, fontsize=7.5)
        upper.plot([], [], "o", color=GREY, markerfacecolor="white", label=f"under {FEW} frames")
        upper.set(ylabel="Share of frames that are right", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        upper.set_title(title)
        upper.legend(loc="upper left")
        upper.grid()
        most = max(10, *(max(curve["counts"]) for curve in curves.values()))
        lower.set_yscale("log")
        lower.set_ylim(LEAST, most * (most / LEAST) ** 0.4)  # room for the numbers over the bars
        lower.yaxis.set_major_formatter("{x:g}")
        lower.set(xlabel="Estimated correctness p̂", ylabel="Frames in the bin")
    return path
