"""Draw the pictures of docs/concepts.md into docs/images."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from amusic_gym.estimation.sic.correction import SIC
from amusic_gym.evaluation.plots.drawing import GREY, INK, figure_at
from amusic_gym.routes.simulate import simulate
from amusic_gym.utils.colours import CORRECT_COLOUR, WRONG_COLOUR

IMAGES = Path(__file__).resolve().parent / "images"
FRAMES, SEED, TECHNIQUE = 90, 17, 0


def draw_sic(path: Path) -> None:
    """A score matrix with the matches of each row alone, and with those that SIC corrected."""
    bank = simulate(SEED, queries=FRAMES, references=FRAMES, techniques=1)
    scores = np.asarray(bank.scores[TECHNIQUE])
    sic = SIC(bank.references)
    places = {
        "best of each row": scores.argmax(axis=1),
        "corrected by SIC": np.array([sic.correct(row).place for row in scores]),
    }
    with figure_at(path, 8.6, 4.4) as figure:
        for axes, (name, found) in zip(
            figure.subplots(1, 2, sharey=True), places.items(), strict=True
        ):
            right = bank.truth.correct(found)
            axes.imshow(scores, cmap="Greys_r", aspect="equal")
            frames = np.arange(FRAMES)
            axes.plot(found[~right], frames[~right], "x", color=WRONG_COLOUR, markersize=5)
            axes.plot(found[right], frames[right], "o", color=CORRECT_COLOUR, markersize=3)
            axes.set_title(f"{name}: {right.mean():.0%} right")
            axes.set_xlabel("Place of the map")
        figure.axes[0].set_ylabel("Frame of the run")


STEPS = (
    ("action", "one bit per\ntechnique"),
    ("run", "their score rows\non the next frame"),
    ("estimate", "SIC, MuSIC: place,\nconfidence, p̂"),
    ("reward", "p̂ − λ · compute"),
    ("observation", "what a robot\nwould know"),
)


def draw_step(path: Path) -> None:
    """The parts of a step in a row, and the way back to the next action."""
    with figure_at(path, 8.6, 2.0) as figure:
        axes = figure.add_subplot(xlim=(-0.1, len(STEPS)), ylim=(-0.75, 1.05))
        axes.set_axis_off()
        for i, (name, about) in enumerate(STEPS):
            box = {"boxstyle": "round,pad=0.5", "facecolor": "#EAF2F8", "edgecolor": INK}
            axes.text(i + 0.45, 0.8, name, ha="center", va="center", weight="bold", bbox=box)
            axes.text(i + 0.45, 0.35, about, ha="center", va="top", fontsize=9)
            if i:
                ends = {"xy": (i + 0.12, 0.8), "xytext": (i - 0.2, 0.8)}
                axes.annotate("", **ends, arrowprops={"arrowstyle": "->", "color": INK})
        axes.annotate(
            "",
            xy=(0.45, -0.25),
            xytext=(len(STEPS) - 0.55, -0.25),
            arrowprops={"arrowstyle": "->", "color": GREY, "connectionstyle": "bar,fraction=-0.06"},
        )
        words = {"ha": "center", "va": "center", "color": GREY, "backgroundcolor": "white"}
        axes.text(len(STEPS) / 2, -0.6, "the selector acts again", **words)


if __name__ == "__main__":
    draw_sic(IMAGES / "sic.png")
    draw_step(IMAGES / "step.png")
