"""The recordings of docs/results.md, and tours of them, as score banks."""

from pathlib import Path
from typing import Any

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.cli.images import extract_tour
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
            extract_tour(tour, made, TOLERANCE, name=name, out=folder, progress=True)
        banks.append(ScoreBank.load(folder))
    return banks
