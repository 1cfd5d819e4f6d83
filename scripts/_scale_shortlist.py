"""What it would cost in accuracy if only a shortlist of the places had scores."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _drives import drive
from _scale_growth import Row

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ranking import highest
from amusic_gym.cli.demo_tours import FIRST_WORLD, WORLDS
from amusic_gym.cli.images import extract_tour
from amusic_gym.evaluation.metrics import summarise
from amusic_gym.routes.tours import make_tour
from amusic_gym.worlds import render_folders

TOLERANCE = 2
TECHNIQUES = ("hog", "calc", "netvlad")  # on rendered images
SECONDS = {"HOG": 1.0, "CALC": 1.0, "NetVLAD": 1.0}  # which change nothing here

FILLS = ("floor", "mean", "none")
"""What places beyond the shortlist get: the least score of it, the row's mean, −∞."""


def rendered(out: Path, places: int) -> ScoreBank:
    """A tour through the demo's rendered worlds, joined in one map; images are kept in ``out``."""
    parts = []
    for seed, world in enumerate(WORLDS, FIRST_WORLD):
        images = out / "images" / world.kind
        render_folders(images, [world.condition], seed=seed, places=places, kind=world.kind)
        parts.append((images / "reference", images / world.condition))
    tour = make_tour(parts, seed=1)
    return extract_tour(tour, TECHNIQUES, TOLERANCE, seconds=SECONDS, cache=out / "cache")


def shortened(bank: ScoreBank, share: float, fill: str) -> ScoreBank:
    """The bank as a shortlist leaves it: of every row only the best share of the scores exists."""
    scores = np.array(bank.scores)
    count = max(1, round(share * bank.references))
    for row in scores.reshape(-1, bank.references):
        kept = highest(row, count)
        rest = {"floor": row[kept[-1]], "mean": row.mean(), "none": -np.inf}[fill]
        best = row[kept]
        row[:] = np.minimum(rest, best[-1])
        row[kept] = best
    return ScoreBank(
        scores,
        bank.techniques,
        bank.seconds,
        tolerance=bank.tolerance,
        ground_truth=bank.truth,
        name=bank.name,
    )


def driven(banks: Sequence[ScoreBank], share: float, fill: str, statistic: str) -> Row:
    """Means over routes of which a shortlist is left.

    Returns:
        ``single``: accuracy of each technique alone; ``music`` and ``music_auc``: accuracy and AUC
        of all of them.
    """
    left = [shortened(bank, share, fill) for bank in banks] if fill else banks
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* has no correct match", UserWarning)
        single = [
            summarise(drive(f"single:{name}", bank, statistic))["accuracy"]
            for bank in left
            for name in bank.techniques
        ]
        music = [summarise(drive("music", bank, statistic)) for bank in left]
    return {
        "single": float(np.mean(single)),
        "music": float(np.mean([row["accuracy"] for row in music])),
        "music_auc": float(np.mean([row["auc"] for row in music])),
    }
