"""What SIC needs to know of every score row, computed once per bank and row, when first used."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from amusic_gym.bank import ScoreBank


class PreparedRows:
    """Mean, scale and candidates of the rows of a bank (A-MuSIC, III-A and III-B).

    The kernels fill a row's entries the first time a technique runs on it, so that a large
    memory-mapped bank is never read as a whole.

    Attributes:
        candidates: K, already clipped to the map's length.
        mean: (T, Q) float64, mean of each score row.
        scale: (T, Q) float64, 1/σ of each row, 0 for a constant one.
        top: (T, Q, K) int32, the K best places, ranked; ties to the lower index.
        ready: (T, Q) uint8, 1 where the row's entries are filled.
    """

    def __init__(self, bank: ScoreBank, candidates: int) -> None:
        techniques, queries, references = bank.shape
        self.candidates = min(candidates, references)
        self.mean: NDArray[np.float64] = np.zeros((techniques, queries))
        self.scale: NDArray[np.float64] = np.zeros((techniques, queries))
        self.top: NDArray[np.int32] = np.zeros((techniques, queries, self.candidates), np.int32)
        self.ready: NDArray[np.uint8] = np.zeros((techniques, queries), np.uint8)
