"""The main job in one go: from images to a selector's drives, a comparison and a page.

It renders worlds, joins them into three tours under changing conditions, runs the techniques on
these, and compares the selectors that ship, whose training saw none of them, with rules of every
kind. With the variable AMUSIC_DATA the real Corridor recording is added, with --bank your own.
"""

import argparse
import os
import shutil
import time
import warnings
from dataclasses import replace
from pathlib import Path

from amusic_agents.shipped import shipped

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
from amusic_gym.utils.checks import whole

REAL = ("HOG", "CALC", "CoHOG", "NetVLAD")

RULES = ("amusic", "amusic:evidence", "oracle", "cascade", "random:0.3")
"""What every route is driven with, besides selectors, fixed subsets and the rivals named."""

SHIPS, MAY_IDLE = "ppo", "ppo:idle"
SELECTORS = {
    SHIPS: "On tours that no training saw, the selector that ships (ppo)",
    MAY_IDLE: "The one that may run nothing on a frame (ppo:idle)",
}
FOLLOWS_STOPS = ("amusic:belief", "ppo@belief")  # driven with on the route with stops, besides


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_shared("--out", type=page_folder, required=False, default=Path("out/demo"))
    parser.add_shared("--bank", help="yours, to compare on besides")
    costs = "paper: the same on every machine; runs: for any techniques (default: paper)"
    parser.add_shared("--costs", choices=COST_MODELS, default="paper", help=costs)
    parser.add_shared("--seed", help="of the first tour; the others follow (default: %(default)s)")


def main(given: argparse.Namespace) -> None:
    """Render, extract, compare, tell."""
    from amusic_agents.selector import load_selector

    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - begun:4.0f} s] {text}", flush=True)

    out: Path = given.out
    others = [ScoreBank.load(bank) for bank in given.bank]
    if folder := os.environ.get("AMUSIC_DATA"):
        others.insert(0, from_recording(Path(folder) / "corridor", REAL))
    others = [bank.with_costs(given.costs) for bank in others]  # refused before long work

    tours = rendered.make_tours(out, whole("--seed", given.seed, 0), say)
    banks = [bank.with_costs(given.costs) for bank in rendered.banks_of(tours, out, say)]
    with_stops = rendered.with_stops(banks[0], out)
    names = [bank.name for bank in banks]
    shutil.copytree(shipped(), out / "run", dirs_exist_ok=True)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*has no correct match")
        say("studying it: rules of every kind at no more compute")
        findings = study_rivals(
            banks,
            {name: [name] for name in SELECTORS},
            out / "study",
            f"process:{rendered.WORKERS}",
        )
        tale = story.on_tours(findings, SELECTORS)

        def driven(bank: ScoreBank) -> list[Contestant]:
            own = all_subsets(bank.techniques)
            rivals = tale.rivals if bank.name in (*names, with_stops.name) else ()
            besides = FOLLOWS_STOPS if bank.name == with_stops.name else ()
            return contestants([*SELECTORS, *own, *RULES, *rivals, *besides])

        say("driving with it, and with the rivals")
        comparison = compare([*banks, *others], driven, out, report=lambda _: None)
        stops = compare([with_stops], driven, out / "stops", report=lambda _: None)
    say("driving live along the first tour")
    moment = rendered.drive(out, load_selector(), tours[0], banks[0])

    sentences = list(tale.sentences)
    for name in dict.fromkeys(bank.name for bank in others):
        rows = [row for row in comparison.rows if row["bank"] == name]
        sentences.append(story.other(name, rows, SHIPS))
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
