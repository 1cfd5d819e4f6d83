"""The parameters of SIC and MuSIC, with the paper's defaults: the one place where they stand."""

from __future__ import annotations

import math
from dataclasses import dataclass

from amusic_gym.names import suggest

STATISTICS = ("mean", "evidence")
"""``mean`` is the paper's average; ``evidence`` is Stouffer's weighted Z (docs/fidelity.md)."""

BLOCK = 10
"""M: frames of a selection and of a re-selection test (A-MuSIC, IV-C)."""

COVERAGE = 0.7
"""E: share of MuSIC's choices that the selected techniques must cover (A-MuSIC, IV-C)."""

COMPUTE_WEIGHT_RANGE = (0.01, 10.0)
"""Range of the compute weight that the observation resolves, on a logarithmic scale."""


@dataclass(frozen=True)
class SICSettings:
    """How SIC corrects a technique (A-MuSIC, III-A and IV-D).

    Args:
        statistic: ``"mean"`` (the paper) or ``"evidence"``.
        candidates: K, how many best-scoring places of a row are candidates; clipped to the map.
        history: F, how many past frames count besides the current one.
        gamma: weight of a row per frame of age, in (0, 1].

    Raises:
        ValueError: for an unknown statistic or a number out of range.
    """

    statistic: str = "evidence"
    candidates: int = 50
    history: int = 1000
    gamma: float = 1.0

    def __post_init__(self) -> None:
        if self.statistic not in STATISTICS:
            raise ValueError(suggest("statistic", self.statistic, STATISTICS))
        if not isinstance(self.candidates, int) or self.candidates < 1:
            raise ValueError(f"candidates (K) is {self.candidates!r}; give a whole number >= 1")
        if not isinstance(self.history, int) or self.history < 0:
            raise ValueError(f"history (F) is {self.history!r}; give a whole number >= 0")
        if not (math.isfinite(self.gamma) and 0.0 < self.gamma <= 1.0):
            raise ValueError(f"gamma is {self.gamma!r}; give a number in (0, 1]")
