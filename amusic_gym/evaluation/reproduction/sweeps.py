"""What K and F of SIC, and E and M of A-MuSIC, do (A-MuSIC, IV-C and figure 3)."""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic.correction import SIC

CANDIDATES = (1, 2, 5, 10, 20, 50, 100)  # K of figure 3
HISTORIES = (1, 10, 100, 1000)  # F of figure 3, frames
BLOCKS = (5, 10, 20, 40)  # M, frames
COVERAGES = (0.5, 0.6, 0.7, 0.8, 0.9)  # E

ADAPTIVE = [f"amusic:mean/{block}/{coverage}" for block in BLOCKS for coverage in COVERAGES]
"""A-MuSIC with every M and E."""


def ablate(banks: Sequence[ScoreBank]) -> Iterator[dict[str, Any]]:
    """Accuracy of SIC, a mean over banks and techniques, and milliseconds per correction.

    Yields:
        ``candidates`` K, ``history`` F, ``accuracy``, ``milliseconds`` (the median, on
        one core).
    """
    for candidates in CANDIDATES:
        for history in HISTORIES:
            settings = SICSettings("mean", candidates=candidates, history=history)
            runs = [
                _corrected(bank, technique, settings)
                for bank in banks
                for technique in range(len(bank.techniques))
            ]
            accuracy, milliseconds = np.array(runs).T
            yield {
                "candidates": candidates,
                "history": history,
                "accuracy": float(accuracy.mean()),
                "milliseconds": float(np.median(milliseconds)),
            }


def _corrected(bank: ScoreBank, technique: int, settings: SICSettings) -> tuple[float, float]:
    """Accuracy of one technique's corrected matches, and milliseconds per correction."""
    rows = [bank.row(technique, q) for q in range(bank.queries)]
    sic = SIC(bank.references, settings)
    start = time.perf_counter()
    places = [sic.correct(row).place for row in rows]
    spent = time.perf_counter() - start
    return float(bank.truth.correct(np.array(places)).mean()), 1e3 * spent / len(rows)
