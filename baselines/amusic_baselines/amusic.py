"""A-MuSIC, the paper's rule (III-C), driving the environment through the re-select bit."""

from collections.abc import Mapping
from dataclasses import InitVar, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtr

from amusic_baselines.arguments import number, parts, whole
from amusic_gym.estimation.settings import BLOCK, COVERAGE, STATISTICS
from amusic_gym.policies.protocol import Context, Needs
from amusic_gym.policies.registry import AMUSIC, RegisteredPolicy
from amusic_gym.utils.names import suggest

ALPHA = 0.05  # significance level of the re-selection test (A-MuSIC, III-C2)

MOST_BLOCK = 1000

ROUNDING = 1e-9  # corrections this close to each other are equal


def differ(before: ArrayLike, after: ArrayLike, alpha: float = ALPHA) -> bool:
    """Whether a paired, two-sided t-test rejects equal means of (n,) values.

    Never for fewer than two pairs or where all differences are zero; always for a constant other
    difference.
    """
    difference = (np.asarray(after, np.float64) - np.asarray(before, np.float64)).ravel()
    # Corrections are differences of running sums: equal ones may be off by the last bits.
    difference[np.abs(difference) <= ROUNDING] = 0.0
    if difference.size < 2 or not difference.any():
        return False
    deviation = difference.std(ddof=1)
    if deviation == 0.0:
        return True
    t = difference.mean() / (deviation / np.sqrt(difference.size))
    return bool(2.0 * stdtr(difference.size - 1, -abs(t)) < alpha)


@dataclass(eq=False)
class AMuSIC:
    """Runs the techniques of the last selection; selects again when their corrections change."""

    statistic: InitVar[str] = "mean"  # the paper's
    block: int = BLOCK  # M, frames of a selection and of a test
    coverage: InitVar[float] = COVERAGE  # E, share of MuSIC's choices that a selection covers
    alpha: float = ALPHA  # significance level of the test

    def __post_init__(self, statistic: str, coverage: float) -> None:
        told = None if statistic == "evidence" else False  # nothing else carries or discounts
        self.needs = Needs(statistic, told, told, reselection=self.block, coverage=coverage)
        self._selected = np.zeros((0, 0), np.bool_)  # (N, S)
        self._before = np.zeros((0, 0, 0))  # (N, S, M) ch: corrections of the block before
        self._after = np.zeros((0, 0, 0))  # (N, S, M) ĉh: corrections of the running block
        self._fresh = np.zeros(0, np.bool_)  # (N,) routes that have just begun

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Forget the routes of ``mask``."""
        if self._fresh.size != mask.size:
            self._fresh = np.ones(mask.size, np.bool_)
            self._selected = np.zeros((mask.size, 0), np.bool_)
        self._fresh |= mask

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The selected techniques (N, S) and the re-select bit."""
        self._begin(info["present"])
        self._note(info)
        reselect = np.array([self._test(i, frame + 1) for i, frame in enumerate(info["frame"])])
        return np.column_stack([self._selected, reselect])

    def _begin(self, present: NDArray[np.bool_]) -> None:
        """Let all techniques run on routes that have just begun."""
        if self._selected.shape != present.shape:
            self._selected = present.copy()
            self._before = np.zeros((*present.shape, self.block))
            self._after = np.zeros((*present.shape, self.block))
        self._selected[self._fresh] = present[self._fresh]
        self._fresh[:] = False

    def _note(self, info: Mapping[str, Any]) -> None:
        """Take in the last frame's corrections and, after a selection, its set and block."""
        selection = info["selection"]
        happened = selection["happened"]
        self._selected[happened] = selection["selected"][happened]
        self._before[happened] = selection["corrections"][happened]
        seen = np.flatnonzero(info["frame"] >= 0)
        self._after[seen, :, info["frame"][seen] % self.block] = info["correction"][seen]

    def _test(self, i: int, frames: int) -> bool:
        """Whether to select again on route ``i`` now that ``frames`` have been seen."""
        if frames == 0 or frames % self.block:
            return False
        if frames == self.block:
            return True
        active = self._selected[i]
        if differ(self._before[i, active], self._after[i, active], self.alpha):
            return True
        self._before[i] = self._after[i]
        return False


def amusic(argument: str | None, context: Context) -> AMuSIC:
    """``amusic``: the paper's; ``amusic:STATISTIC[/M/E]``: another statistic, other M and E.

    With ``amusic:evidence`` places are carried on and alike rows discounted, unless the user says
    otherwise; the paper's rule knows neither.
    """
    if argument is None:
        return AMuSIC()
    statistic, *numbers = argument.split("/")
    if statistic not in STATISTICS:
        raise ValueError(suggest("statistic of amusic", statistic, STATISTICS))
    if not numbers:
        return AMuSIC(statistic)
    _, block, coverage = parts("amusic", argument, "STATISTIC/M/E")
    return AMuSIC(
        statistic,
        whole("amusic", argument, "M", block, 2, MOST_BLOCK),
        number("amusic", argument, "E", coverage, 0.0, 1.0),
    )


POLICY = RegisteredPolicy(
    "amusic", amusic, AMUSIC, "A-MuSIC", colour="#0072B2", marker="D", has_variants=True
)
