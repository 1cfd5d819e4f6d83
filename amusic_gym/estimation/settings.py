"""The parameters of SIC and MuSIC, with the paper's defaults: the one place where they stand."""

from __future__ import annotations

from dataclasses import dataclass

from amusic_gym.utils.checks import flag, number, whole
from amusic_gym.utils.names import suggest

ESTIMATORS = {
    "mean": "amusic_gym.estimation.sic.update:SICEstimator",
    "evidence": "amusic_gym.estimation.sic.update:SICEstimator",
    "belief": "amusic_gym.estimation.belief.estimator:BeliefEstimator",
}
"""Statistic → module and class of its estimator (:mod:`amusic_gym.estimation.estimator`)."""

STATISTICS = tuple(ESTIMATORS)
"""``mean`` is the paper's average, ``evidence`` Stouffer's weighted Z, ``belief`` the log-odds of a
filter over places that follows stops, other speeds and jumps (docs/fidelity.md, docs/belief.md)."""

BLOCK = 10
"""M: frames of a selection and of a re-selection test (A-MuSIC, IV-C)."""

COVERAGE = 0.7
"""E: share of MuSIC's choices that the selected techniques must cover (A-MuSIC, IV-C)."""

COMPUTE_WEIGHT_RANGE = (0.01, 10.0)
"""Range of the compute weight that the observation resolves, on a logarithmic scale."""


def carries(statistic: str) -> bool:
    """Whether a statistic comes with carried candidates, and the discount, unless told."""
    return statistic == "evidence"


def statistic_label(statistic: str, carry: bool) -> str:
    """The statistic in tables: with a mark where it does not carry as it does by default."""
    if carry == carries(statistic):
        return statistic
    return f"{statistic}, {'carry' if carry else 'no carry'}"


@dataclass(frozen=True)
class SICSettings:
    """How SIC corrects a technique (A-MuSIC, III-A and IV-C).

    Args:
        statistic: ``"mean"`` (the paper), ``"evidence"`` or ``"belief"``. The other three are for
            the first two: to the belief every place is a candidate, and it forgets as it sees fit.
        candidates: K, how many best-scoring places of a row are candidates; clipped to the map.
        history: F, how many past frames count besides the current one.
        gamma: weight of a row per frame of age, in (0, 1].
        carry: whether the technique's last match and the last fused prediction, both moved on by
            one place per frame, are candidates too; None: with ``evidence``.
        discount: whether MuSIC discounts the statistic of a technique whose neighbouring rows are
            alike (serial correlation); None: with ``evidence``.

    Raises:
        ValueError: for an unknown statistic or a number out of range.
    """

    statistic: str = "evidence"
    candidates: int = 50
    history: int = 1000
    gamma: float = 1.0
    carry: bool | None = None
    discount: bool | None = None

    def __post_init__(self) -> None:
        if self.statistic not in ESTIMATORS:
            raise ValueError(suggest("statistic", self.statistic, tuple(ESTIMATORS)))
        object.__setattr__(self, "candidates", whole("candidates (K)", self.candidates, 1))
        object.__setattr__(self, "history", whole("history (F)", self.history, 0))
        gamma = number("gamma", self.gamma, "a number in (0, 1]")
        if not 0.0 < gamma <= 1.0:
            raise ValueError(f"gamma is {self.gamma!r}; give a number in (0, 1]")
        object.__setattr__(self, "gamma", gamma)
        for name in ("carry", "discount"):
            given = getattr(self, name)
            if given is None:
                given = carries(self.statistic)
            if flag(name, given) and self.statistic == "belief":
                raise ValueError(f"{name} is True, but 'belief' has no candidates; leave it out")
            object.__setattr__(self, name, given)
