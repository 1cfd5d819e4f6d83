"""The main job in one go: from images to a trained selector, a comparison and a page.

It renders routes under several conditions, runs the techniques on them, trains a selector on
simulated routes, and compares it on the rendered ones, which no training saw. With the variable
AMUSIC_DATA the real Corridor recording is added, with --bank your own.
"""

from __future__ import annotations

import os
import time
import warnings
from functools import partial
from pathlib import Path

from _cli import Parser, run
from _contestants import contestants

from agents.config import TrainingConfig
from agents.frozen import Frozen
from agents.run_folder import CHECKPOINT
from agents.selector import load_selector
from agents.training import train
from amusic_gym.bank import ScoreBank
from amusic_gym.comparison import Comparison, all_subsets, compare, draw, table
from amusic_gym.importers import from_recording
from amusic_gym.metrics import mean_rows, summarise
from amusic_gym.plots import front
from amusic_gym.report import ReportFigure, write_report
from amusic_gym.rollout import rollout
from amusic_gym.routes.simulate import planted
from amusic_gym.settings import SICSettings

import _demo_images as images  # isort: skip
import _demo_story as story  # isort: skip
from _demo_drive import drive  # isort: skip

PLANTED_SEED = 3_100
PLANTED = "planted"
REAL = ("HOG", "CALC", "CoHOG", "NetVLAD")
TIMESTEPS = 700_000
POLICIES = ("amusic", "amusic:evidence", "music", "cascade", "random:0.3", "oracle")

_begun = time.monotonic()


def say(text: str) -> None:
    """Print a heading with the seconds since the start."""
    print(f"[{time.monotonic() - _begun:4.0f} s] {text}", flush=True)


def others(given: list[Path]) -> list[ScoreBank]:
    """The simulated route whose good technique changes, and recordings."""
    changing = planted(PLANTED_SEED)
    changing.name = PLANTED
    banks = [changing]
    if folder := os.environ.get("AMUSIC_DATA"):
        banks.append(from_recording(Path(folder) / "corridor", REAL))
    return [*banks, *(ScoreBank.load(bank) for bank in given)]


def freeze(comparison: Comparison) -> str:
    """Compare the selector on the planted route with itself when it no longer looks."""
    rows = [row for row in comparison.rows if row["bank"] == PLANTED]
    selector = story.best_within(rows, "ppo:", 0.5)
    if selector is None:
        return "On the planted route the selector always ran more than half of all techniques."
    trace = next(
        t
        for t in comparison.traces
        if (t.bank, t.policy, t.compute_weight)
        == (PLANTED, selector["policy"], selector["compute_weight"])
    )
    policy = Frozen(trace.ran.mean(axis=0), trace.statistic, carry=trace.carry)
    frozen = rollout(policy, planted(PLANTED_SEED), name="frozen")
    return story.planted(rows, summarise(frozen), selector)


def main() -> None:
    """Parse, render, extract, train, compare, tell."""
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder to write")
    parser.add_argument("--bank", nargs="+", action="extend", type=Path, default=[], help="yours")
    parser.add_argument("--timesteps", type=int, default=TIMESTEPS, help="frames of training")
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    given = parser.parse_args()

    rendered = images.rendered_banks(given.out, say)

    say(f"training a selector on {given.timesteps} frames of simulated routes")
    run_folder = given.out / "run"
    config = TrainingConfig(timesteps=given.timesteps, seed=given.seed)
    train(run_folder, config, resume=(run_folder / CHECKPOINT).exists())

    say("comparing it")
    policies = [*POLICIES, f"ppo:{run_folder}"]
    with warnings.catch_warnings():
        # Techniques that are never right are part of simulated routes, not a sign of bad input.
        warnings.filterwarnings("ignore", message=".*has no correct match")
        comparison = compare(
            [*rendered, *others(given.bank)],
            lambda bank: contestants([*policies, *all_subsets(bank.techniques)]),
            given.out,
            statistic=SICSettings.statistic,
            report=partial(print, flush=True),
        )
    say("driving live along the first rendered route")
    live = drive(given.out, load_selector(run_folder), rendered[0])
    tell(given.out, comparison, [bank.name for bank in rendered], live)
    say(f"done: open {given.out / 'index.html'}")


def tell(out: Path, comparison: Comparison, held_out: list[str], live: Path) -> None:
    """Print the table and what it says, draw the figures, write the page."""
    mean = mean_rows([row for row in comparison.rows if row["bank"] in held_out])
    rest = list(dict.fromkeys(row["bank"] for row in comparison.rows))
    sentences = story.held_out(mean, len(held_out))
    sentences.append(freeze(comparison))
    for name in rest:
        if name not in (*held_out, PLANTED):
            rows = [row for row in comparison.rows if row["bank"] == name]
            sentences.append(story.other(name, rows))
    say("drawing")
    first = ReportFigure(
        front(mean, out / "front.png"),
        f"AUC against compute, mean over the {len(held_out)} rendered routes.",
    )
    sheet = ReportFigure(
        images.contact_sheet(out),
        "Two places of each rendered route: as the map has them, and below as the two drives saw"
        " them.",
    )
    moment = ReportFigure(
        live,
        "A moment of the selector's live drive (drive.mp4): what the camera sees, the place it is"
        " taken for, what ran and how long that took.",
    )
    figures = [first, sheet, moment, *draw(comparison, out)]
    title = "A learned selector of place-recognition techniques"
    page_rows = [*mean, *comparison.rows]
    write_report(
        out / "index.html", title=title, sentences=sentences, rows=page_rows, figures=figures
    )
    print(f"\n{table(comparison)}\n")
    for sentence in sentences:
        print(sentence)


if __name__ == "__main__":
    run(main)
