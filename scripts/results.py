"""Make the tables of docs/results.md from the recordings in $AMUSIC_DATA, and print them.

  tours     five tours of Corridor, Gardens Point and Nordland
  recorded  these three as they are

The selectors stand against rules of every kind. What is finished in DIR is not done again.
"""

from __future__ import annotations

import argparse
import os
import warnings
from pathlib import Path
from typing import Any

from _cli import Parser, destination, pairs, run

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.costs import COST_MODELS
from amusic_gym.evaluation.study import figures
from amusic_gym.evaluation.study.rivals import study_rivals
from amusic_gym.evaluation.study.tables import tables
from amusic_gym.extraction import extract
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.tours import make_tour
from amusic_gym.techniques import make_technique

TECHNIQUES = ("hog", "calc", "netvlad")
TOLERANCE = 2
FOLDERS = {
    "corridor": ("corridor/reference", "corridor/query"),
    "gardens": ("gardens_point/day_left", "gardens_point/night_right"),
    "nordland": ("nordland/summer", "nordland/winter"),
}
STRONG = ("plain", "night:1", "blur:1", "shift:1", "fog:1", "rain:1", "glare:1")
TOURS: dict[int, tuple[tuple[str, range | None], ...]] = {
    211: (("corridor", None), ("gardens", None), ("nordland", range(0, 400, 2))),
    212: (("nordland", range(400, 900, 2)), ("gardens", None)),
    213: (("gardens", None), ("corridor", None), ("nordland", range(1600, 2000, 2))),
    214: (("nordland", range(1000, 1500, 2)), ("corridor", None), ("nordland", range(600, 800))),
    215: (("corridor", None), ("nordland", range(1500, 1900, 2)), ("gardens", None)),
}
"""Seed of a tour → its parts, and which images of each, if not all."""

RECORDED: tuple[tuple[str, range | None], ...] = (
    ("corridor", None),
    ("gardens", None),
    ("nordland", range(200, 1200, 2)),
)


def folders(data: Path, name: str, cut: range | None) -> tuple[ImageFolder, ImageFolder]:
    """Reference and query of a recording, or some of their images."""
    how: dict[str, Any] = (
        {} if cut is None else {"first": cut.start, "step": cut.step, "count": len(cut)}
    )
    reference, query = (ImageFolder(data / folder, **how) for folder in FOLDERS[name])
    return reference, query


def make_banks(data: Path, kind: str, out: Path) -> list[ScoreBank]:
    """The banks of one kind of route, extracted unless they are there."""
    calc = data / "calc" / "calc_weights.npz"
    made = [make_technique(name, calc if name == "calc" else None) for name in TECHNIQUES]
    if kind == "recorded":
        parts = {name: ([folders(data, name, cut)], ["plain"], 0) for name, cut in RECORDED}
    else:
        parts = {
            f"tour-{seed}": ([folders(data, *part) for part in of], list(STRONG), seed)
            for seed, of in TOURS.items()
        }
    banks = []
    for name, (pairs_of, conditions, seed) in parts.items():
        folder = out / "banks" / name
        if not folder.exists():
            tour = make_tour(pairs_of, conditions, seed=seed)
            extract(
                tour.reference,
                tour.query,
                made,
                tolerance=TOLERANCE,
                ground_truth=tour.ground_truth(TOLERANCE),
                source=tour.source,
                name=name,
                out=folder,
                progress=True,
            )
        banks.append(ScoreBank.load(folder))
    return banks


def _parser() -> Parser:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("kind", choices=("tours", "recorded"), help="see above")
    add("--out", type=destination, required=True, metavar="DIR", help="the folder to write")
    add(
        "--selector",
        nargs="+",
        default=["ships=ppo", "ships, may idle=ppo:idle"],
        metavar="NAME=POLICY,...",
        help="ppo or ppo:RUN; one, or five of one training (default: those that ship)",
    )
    add("--costs", choices=COST_MODELS, default="paper", help="cost model (default: paper)")
    return parser


def main() -> None:
    """Make the banks, run the study, print the table of the mean."""
    args = _parser().parse_args()
    data = os.environ.get("AMUSIC_DATA")
    if not data:
        raise ValueError("AMUSIC_DATA names no folder; let it name that of the recordings")
    selectors = {
        name: policies.split(",") for name, policies in pairs(args.selector, "--selector").items()
    }
    banks = make_banks(Path(data), args.kind, args.out)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*has no correct match")
        findings = study_rivals(
            [bank.with_costs(args.costs) for bank in banks], selectors, args.out / args.costs
        )
    figures.draw(findings, args.out / args.costs)
    for table in tables(findings):
        if "mean over" in table.title:
            print(f"\n{table.markdown()}")


if __name__ == "__main__":
    run(main)
