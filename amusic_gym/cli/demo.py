"""The main job in one go: from images to a trained selector, a comparison and a page.

It renders worlds, joins them into tours under changing conditions, runs the techniques on these,
trains a selector on simulated routes by policy iteration, and compares it on the tours, which no
training saw, with the selector that ships and with rules of every kind. With the variable
AMUSIC_DATA the real Corridor recording is added, with --bank your own.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from dataclasses import replace
from pathlib import Path

from amusic_agents.config import RolloutConfig, TrainingConfig
from amusic_agents.run_folder import CHECKPOINT, stored_config
from amusic_agents.selector import load_selector
from amusic_agents.training import train

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.costs import COST_MODELS
from amusic_gym.banks.importers import from_recording
from amusic_gym.cli import demo_story as story
from amusic_gym.cli import demo_tours as rendered
from amusic_gym.cli.parser import Parser, page_folder
from amusic_gym.evaluation.comparison import compare
from amusic_gym.evaluation.contestants import Contestant, all_subsets, contestants
from amusic_gym.evaluation.figures import draw, of_page
from amusic_gym.evaluation.report import ReportFigure, write_report
from amusic_gym.evaluation.study.figures import draw as draw_study
from amusic_gym.evaluation.study.page import believed, page_rows
from amusic_gym.evaluation.study.rivals import study_rivals

REAL = ("HOG", "CALC", "CoHOG", "NetVLAD")
ITERATIONS = 3
QUICK = {"states": 3_000, "epochs": 8}
"""Of an iteration: less than the defaults, so that the training takes a minute or two."""

RULES = ("amusic", "amusic:evidence", "oracle", "cascade", "random:0.3")
"""What every route is driven with, besides selectors, fixed subsets and the rivals named."""

TRAINED, SHIPS, MAY_IDLE = (
    *("selector trained here", "selector that ships"),
    "selector that ships and may idle",
)
SELECTORS = {
    SHIPS: "On tours that no training saw, the selector that ships",
    TRAINED: "The one trained here",
    MAY_IDLE: "The one that ships and may run nothing on a frame",
}
FOLLOWS_STOPS = ("amusic:belief", "ppo@belief")
"""Driven with on the route with stops, besides."""


def training(folder: Path, iterations: int, seed: int) -> TrainingConfig:
    """How to train on simulated routes, by their ground truth.

    Raises:
        ValueError: if the folder holds a training with other settings.
    """
    config = TrainingConfig(
        algorithm="rollouts",
        seed=seed,
        threads=2,
        reward="ground_truth",
        held_out=12,
        rollouts=RolloutConfig(iterations=iterations, **QUICK),
    )
    if (folder / CHECKPOINT).exists() and stored_config(folder) != config:
        raise ValueError(
            f"{folder} holds a training with another --seed or other --iterations; give another"
            f" --out, or delete {folder}"
        )
    return config


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_shared("--out", type=page_folder, required=False, default=Path("out/demo"))
    parser.add_shared("--bank", help="yours, to compare on besides")
    costs = "paper: the same on every machine; runs: for any techniques (default: paper)"
    parser.add_shared("--costs", choices=COST_MODELS, default="paper", help=costs)
    parser.add_argument("--iterations", type=int, default=ITERATIONS, help="of the training")
    parser.add_shared("--seed", help="of the training")


def main(given: argparse.Namespace) -> None:
    """Render, extract, train, compare, tell."""
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - begun:4.0f} s] {text}", flush=True)

    out: Path = given.out
    others = [ScoreBank.load(bank) for bank in given.bank]
    if folder := os.environ.get("AMUSIC_DATA"):
        others.insert(0, from_recording(Path(folder) / "corridor", REAL))
    others = [bank.with_costs(given.costs) for bank in others]  # refused before long work

    run_folder = out / "run"
    config = training(run_folder, given.iterations, given.seed)
    tours = rendered.make_tours(out, say)
    banks = [bank.with_costs(given.costs) for bank in rendered.banks_of(tours, out, say)]
    with_stops = rendered.with_stops(banks[0], out)
    names = [bank.name for bank in banks]
    say(f"training a selector on simulated routes: {given.iterations} iterations")
    train(run_folder, config, resume=(run_folder / CHECKPOINT).exists())
    selectors = {TRAINED: f"ppo:{run_folder}", SHIPS: "ppo", MAY_IDLE: "ppo:idle"}

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*has no correct match")
        say("studying it: rules of every kind at no more compute")
        findings = study_rivals(
            banks,
            {name: [spec] for name, spec in selectors.items()},
            out / "study",
            rendered.EXECUTOR,
        )
        tale = story.on_tours(findings, SELECTORS)

        def driven(bank: ScoreBank) -> list[Contestant]:
            own = all_subsets(bank.techniques)
            rivals = tale.rivals if bank.name in (*names, with_stops.name) else ()
            besides = FOLLOWS_STOPS if bank.name == with_stops.name else ()
            named = [replace(*contestants([spec]), name=name) for name, spec in selectors.items()]
            return [*named, *contestants([*own, *RULES, *rivals, *besides])]

        say("driving with it, and with the rivals")
        comparison = compare([*banks, *others], driven, out, report=lambda _: None)
        stops = compare([with_stops], driven, out / "stops", report=lambda _: None)
    say("driving live along the first tour")
    moment = rendered.drive(out, load_selector(run_folder), tours[0], banks[0])

    sentences = list(tale.sentences)
    for name in dict.fromkeys(bank.name for bank in others):
        rows = [row for row in comparison.rows if row["bank"] == name]
        sentences.append(story.other(name, rows, TRAINED))
    say("drawing")
    apart = (MAY_IDLE, *tale.rivals)  # of figures of curves, which would not fit
    pictured = [
        trace
        for trace in comparison.traces
        if trace.policy not in apart or trace.policy.startswith("single:")
    ]
    traces = [*comparison.traces, *stops.traces]
    kept = {row["policy"] for row in comparison.rows}
    write_report(
        out / "index.html",
        title="A learned selector of place-recognition techniques",
        sentences=sentences,
        rows=[
            *(row for row in page_rows(findings) if row["policy"] in kept),
            *(row for row in [*stops.rows, *comparison.rows] if row["bank"] not in names),
        ],
        traces=traces,
        images=comparison.images | stops.images,
        highlights=story.highlights(traces, names, with_stops.name, SHIPS, tale),
        tables=[tale.table],
        below=believed(findings),
        figures=[
            ReportFigure(
                rendered.contact_sheet(tours[0], out),
                "One place for each spell of the first tour: as the map has it, and below as the"
                " drive sees it.",
            ),
            ReportFigure(
                moment,
                "A moment of the selector's live drive (drive.mp4): what the camera sees, the place"
                " it is taken for, what ran and how long that took.",
            ),
            *of_page(draw(replace(comparison, traces=pictured), out)),
        ],
    )
    draw_study(findings, out / "study")
    print(f"\n{tale.table.text()}\n")
    for sentence in sentences:
        print(sentence)
    say(f"done: open {out / 'index.html'}")
