"""Limits on what a frame may cost: a budget that λ is steered to, and a cap for every frame."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median_low
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.estimation.settings import COMPUTE_WEIGHT_RANGE
from amusic_gym.policies.protocol import Policy, Rater, Selector
from amusic_gym.policies.registry import parse
from amusic_gym.utils.checks import number
from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_gym.live.drives import FrameResult

WINDOW = 200  # frames over which the average is held to the budget
MARGIN = 0.05  # share of the budget by which that average may be off before choices are changed
GAIN = 0.05  # what ln λ rises by after a frame that costs a whole budget too much

MEMORY = 9
"""Runs of which the median is what a technique is taken to cost, where costs are measured."""

WORST = 2.0  # times what all techniques are expected to cost that a frame is charged with at most

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Limits:
    """What a frame may cost; at most one of the three budgets.

    Attributes:
        budget_ms: milliseconds per frame, on average over the last `WINDOW` frames.
        budget_fps: the same as frames per second.
        budget_joules: joules per frame, likewise.
        joules: technique's name -> joules of a run, of every technique; with `budget_joules`.
        cap_ms: milliseconds that no frame is expected to exceed.

    Raises:
        ValueError: for numbers that are not above 0, or limits that do not go together.
    """

    budget_ms: float | None = None
    budget_fps: float | None = None
    budget_joules: float | None = None
    joules: Mapping[str, float] | None = None
    cap_ms: float | None = None

    def __post_init__(self) -> None:
        named = ("budget_ms", "budget_fps", "budget_joules", "cap_ms")
        given = [name for name in named if getattr(self, name) is not None]
        for name in given:
            if number(name, getattr(self, name), "a number above 0") <= 0:
                raise ValueError(f"{name} is {getattr(self, name)}; give a number above 0")
        if len(given) - ("cap_ms" in given) > 1:
            raise ValueError(f"{' and '.join(given[:2])} are both budgets; give one")
        if (self.joules is None) != (self.budget_joules is None):
            raise ValueError("budget_joules goes with joules, what a run of each technique takes")

    def __bool__(self) -> bool:
        """Whether there is any."""
        return self != Limits()

    @property
    def budget(self) -> float | None:
        """Per frame, in milliseconds or joules."""
        if self.budget_fps is not None:
            return 1000.0 / self.budget_fps
        return self.budget_ms if self.budget_joules is None else self.budget_joules

    def check(self, spec: str) -> None:
        """Refuse with a ValueError a policy, as on the command line, that no budget can steer."""
        policy, argument = parse(spec)
        if self.budget is not None and not policy.reads_weight(argument or ""):
            raise ValueError(f"policy {spec} has no λ to hold a budget with; take ppo or voi")

    def costs(self, techniques: Sequence[str], seconds: ArrayLike) -> Floats:
        """(T,) what the policy should weigh a run with: joules where these are limited.

        Raises:
            ValueError: for an unknown technique, or one whose joules are not given.
        """
        if self.joules is None:
            return np.asarray(seconds, np.float64)
        for name in self.joules:
            if name not in techniques:
                raise ValueError(suggest("technique", name, techniques))
        lacking = [name for name in techniques if name not in self.joules]
        if lacking:
            raise ValueError(f"joules of {', '.join(lacking)} are not given; give each technique's")
        return np.array([self.joules[name] for name in techniques], np.float64)

    def keeper(
        self,
        policy: Policy,
        techniques: Sequence[str],
        seconds: ArrayLike,
        *,
        measured: bool,
        weight: float,
    ) -> Keeper | None:
        """What keeps a policy within the limits; None where there are none.

        Args:
            policy: a selector without re-selection, whose runs on past frames nobody foresees.
            techniques: T names.
            seconds: (T,) of a run.
            measured: whether frames are charged with their wall time; else with `seconds`.
            weight: λ at first.

        Raises:
            ValueError: for another policy, or limits below what the cheapest technique costs.
        """
        if not self:
            return None
        if not isinstance(policy, Selector) or policy.needs.reselection is not None:
            raise ValueError(
                f"a budget or cap cannot hold {type(policy).__name__}, which runs what it needs"
                " or runs techniques on past frames; take a policy such as ppo"
            )
        clock = Costs(1000.0 * np.asarray(seconds), measured)
        charged = clock if self.joules is None else Costs(self.costs(techniques, seconds), False)
        for limit, costs, unit in (
            (self.cap_ms, clock, "ms"),
            (self.budget, charged, "ms" if self.joules is None else "J"),
        ):
            least = float(costs.runs.min())
            if limit is not None and not policy.needs.allow_idle and limit < least:
                raise ValueError(
                    f"no frame fits within {limit:g} {unit}: the cheapest technique,"
                    f" {techniques[int(costs.runs.argmin())]}, costs {least:.3g} {unit}; give more,"
                    " a cheaper technique, or seconds= of this machine"
                )
        return Keeper(self, policy, clock, charged, weight)


class Costs:
    """What a frame costs, by runs of techniques (T,) as declared.

    With ``measured`` wall times, in milliseconds, count instead once there are some.
    """

    def __init__(self, runs: ArrayLike, measured: bool) -> None:
        self.runs: Floats = np.array(runs, np.float64)  # (T,) as it is expected
        self.measured = measured
        self.besides = 0.0  # of a frame, besides its runs
        self._last = [deque([cost], MEMORY) for cost in (*self.runs.tolist(), 0.0)]

    def of(self, subsets: Flags) -> Any:
        """(...,) expected of subsets (..., T)."""
        return subsets @ self.runs + self.besides

    def note(self, seen: FrameResult) -> float:
        """What a frame came to; measured ones are learned from."""
        if not self.measured:
            return float(seen.ran @ self.runs)
        rest = max(0.0, seen.milliseconds - float(seen.run_milliseconds.sum()))
        for t in np.flatnonzero(seen.ran).tolist():
            self._last[t].append(float(seen.run_milliseconds[t]))
            self.runs[t] = median_low(self._last[t])  # one that waited for a compiler is no guide
        self._last[-1].append(rest)
        self.besides = median_low(self._last[-1])
        return seen.milliseconds


class Keeper:
    """Keeps a selector within limits, frame by frame.

    λ is steered so that frames cost the budget on average: ln λ integrates what they cost too much
    or too little. Where that alone leaves the average over the last `WINDOW` frames, those before
    the first taken to be at the budget, off by more than `MARGIN`, the choice itself is changed.
    """

    def __init__(
        self, limits: Limits, policy: Selector, clock: Costs, charged: Costs, weight: float
    ) -> None:
        self.budget = limits.budget
        self.cap = math.inf if limits.cap_ms is None else limits.cap_ms
        # λ for the next frame
        self.weight = float(np.clip(weight, *COMPUTE_WEIGHT_RANGE)) if self.budget else weight
        self.clock, self.charged = clock, charged
        self._policy = policy
        self._refused = 0.0  # what the policy wanted to spend beyond what its frame cost
        self._spent = deque([self.budget or 0.0] * WINDOW, WINDOW)

    def choose(self, wanted: Flags, observation: NDArray[np.float32]) -> Flags:
        """What runs (T,) in place of what the policy wants (T,) after an observation (1, D).

        A `Rater` is asked for its next best.
        """
        chosen = self._within(wanted, observation)
        self._refused = float(self.charged.of(wanted) - self.charged.of(chosen))
        return chosen

    def _within(self, wanted: Flags, observation: NDArray[np.float32]) -> Flags:
        least, most = self._range()
        if self._fits(wanted, most):
            if self.charged.of(wanted) >= least:
                return wanted
            return self._reduced(np.ones_like(wanted), most)
        if isinstance(self._policy, Rater):
            subsets, ratings = self._policy.rate(observation)
            fits = self._fits(subsets, most) & np.isfinite(ratings)
            if fits.any():
                best: Flags = subsets[np.where(fits, ratings, -np.inf).argmax()]
                return best
        return self._reduced(wanted, most)

    def _range(self) -> tuple[float, float]:
        """Least and most that the next frame may be charged."""
        if self.budget is None:
            return -math.inf, math.inf
        before = sum(self._spent) - self._spent[0]
        low, high = ((1.0 + off) * WINDOW * self.budget for off in (-MARGIN, MARGIN))
        return low - before, high - before

    def _fits(self, subsets: Flags, most: float) -> Any:
        return (self.clock.of(subsets) <= self.cap) & (self.charged.of(subsets) <= most)

    def _reduced(self, subset: Flags, most: float) -> Flags:
        """A subset without its dearest techniques, as many as have to go; the cheapest if all."""
        kept = subset.copy()
        for t in np.argsort(-self.clock.runs if self.cap < math.inf else -self.charged.runs):
            if self._fits(kept, most):
                break
            kept[t] = False
        if not kept.any() and not self._policy.needs.allow_idle:
            kept[int(self.charged.runs.argmin())] = True
        return kept

    def note(self, seen: FrameResult) -> None:
        """Charge a frame, and steer."""
        spent = self.clock.note(seen)
        if self.budget is None:
            return
        spent = spent if self.charged is self.clock else self.charged.note(seen)
        most = WORST * float(self.charged.of(np.ones_like(seen.ran)))
        spent = min(spent, most)  # else a compiler's seconds would starve all that follows
        self._spent.append(spent)
        low, high = COMPUTE_WEIGHT_RANGE
        step = math.exp(GAIN * ((spent + self._refused) / self.budget - 1.0))
        self.weight = min(max(self.weight * step, low), high)
