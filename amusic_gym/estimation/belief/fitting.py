"""Fitting the belief's rates: how likely it finds the truth on routes whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.rows import Run
from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.belief.filter import hear
from amusic_gym.estimation.belief.memory import REACH, Minds, begin, minds_at
from amusic_gym.estimation.belief.rates import WAYS, Rates
from amusic_gym.kernels.compiling import without_gil

LEAST = 1e-3
"""Probability of the truth below which a frame is lost anyway: no fit can win much there."""

Floats = NDArray[np.float64]


class Limits(NamedTuple):
    """Where a rate is looked for: from a value to a value, and whether on a logarithmic scale."""

    low: float
    high: float
    logarithmic: bool


SEARCHED: dict[str, Limits] = {
    "sharpness": Limits(0.1, 6.0, True),
    "convexity": Limits(0.0, 2.0, False),
    "most": Limits(2.0, 12.0, True),
    "trust": Limits(0.2, 0.98, False),
    "sharper": Limits(0.02, 0.98, False),
    "sharpest": Limits(0.02, 0.98, False),
    "learn": Limits(0.02, 0.5, True),
    "relearn": Limits(1e-4, 0.05, True),
    "hub": Limits(0.0, 1.0, False),
    "hub_spread": Limits(0.0, 1.0, False),
    "hub_count": Limits(1.0, 100.0, True),
    "hub_memory": Limits(100.0, 2000.0, True),
    "novel": Limits(0.01, 1.5, True),
    "repeat": Limits(0.0, 1.0, False),
    "contrast": Limits(0.0, 2.0, False),
    "stand": Limits(20.0, 300.0, True),
    "jump": Limits(0.005, 0.1, True),
    "jump_novel": Limits(0.0, 3.0, False),
    "jump_usual": Limits(0.5, 5.0, False),
    "change": Limits(0.003, 0.2, True),
    "slack": Limits(1e-4, 0.3, True),
    "steady": Limits(0.05, 0.95, False),
    "steady_jump": Limits(1e-4, 0.01, True),
    "wandering": Limits(0.01, 0.99, False),
    "wander": Limits(0.01, 0.9, True),
    "leave": Limits(1e-3, 0.05, True),
    "settle": Limits(1e-4, 0.05, True),
}
"""Limits of every rate, which are assumptions. Those of jumps and stops keep a steady robot from
being believed in for ever: simulated ones are carried away less suddenly than real ones. Those of
``hub_memory``, ``learn`` and ``relearn`` say that a place that attracts queries, or a technique
that is good, stays so: on recordings for longer than on simulated routes (docs/simulation.md)."""

PLAIN = Rates(
    sharpness=0.25,
    convexity=0.9,
    most=6.0,
    trust=0.8,
    sharper=0.4,
    sharpest=0.4,
    learn=0.2,
    relearn=0.01,
    hub=0.85,
    hub_spread=0.8,
    hub_count=2.0,
    hub_memory=150.0,
    novel=1.0,
    repeat=0.3,
    contrast=1.0,
    stand=30.0,
    jump=0.05,
    jump_novel=0.8,
    jump_usual=1.2,
    change=0.1,
    slack=0.005,
    steady=0.7,
    steady_jump=2e-4,
    wandering=0.8,
    wander=0.3,
    leave=0.0015,
    settle=0.0015,
)
"""Plain guesses, from which the search begins."""


def to_unit(rates: Rates) -> Floats:
    """Rates as points of the unit cube that is searched."""
    return np.array([_unit(getattr(rates, name), limits) for name, limits in SEARCHED.items()])


def from_unit(point: Floats) -> Rates:
    """Rates of a point of the unit cube; what lies outside is brought to its face."""
    inside = np.clip(point, 0.0, 1.0).tolist()
    pairs = zip(SEARCHED.items(), inside, strict=True)
    return Rates(**{name: _value(part, limits) for (name, limits), part in pairs})


def _unit(value: float, limits: Limits) -> float:
    low, high, logarithmic = limits
    if logarithmic:
        return math.log(value / low) / math.log(high / low)
    return float((value - low) / (high - low))


def _value(part: float, limits: Limits) -> float:
    low, high, logarithmic = limits
    return float(low * (high / low) ** part if logarithmic else low + part * (high - low))


@without_gil
def drive_route(
    address: int, runs: Any, ran: Any, truth: Any, tolerance: int, places: Any, beliefs: Any
) -> None:
    """Drive one route.

    Args:
        address: of a table of the layout ``MINDS``: the memory of one route, begun.
        runs: (T,) RUN records.
        ran: (T, Q) uint8.
        truth: (Q, R) bool.
        tolerance: places off that still count as true.
        places: (Q,) int64, filled with the predictions.
        beliefs: (Q, 2) filled with the belief around the prediction and in the true places.
    """
    minds = minds_at(address)
    for frame in range(ran.shape[1]):
        hear(minds, 0, 0, frame, runs, ran, tolerance)
        share, whole = 0.0, 0.0
        for place in range(truth.shape[1]):
            whole += minds.joint[place]
            if truth[frame, place]:
                share += minds.joint[place]
        places[frame] = minds.minds[0, 0].place
        beliefs[frame, 0] = minds.minds[0, 0].share
        beliefs[frame, 1] = share / whole


class Drive:
    """A route with its truth, and which techniques run when.

    Args:
        bank: the route.
        ran: (Q, T) bool.
    """

    def __init__(self, bank: ScoreBank, ran: NDArray[np.bool_]) -> None:
        self.bank = bank
        self.ran = np.ascontiguousarray(ran.T)  # (T, Q)
        self.truth = bank.truth.matrix()
        self._prepared = bank.prepared(1)
        self._runs = np.zeros(len(bank.techniques), Run.dtype)
        self._prepared.point(self._runs, np.arange(len(bank.techniques)))

    def drive(self, rates: Rates) -> tuple[NDArray[np.int64], Floats]:
        """Predictions (Q,), and the belief (Q, 2) around them and in the true places."""
        sizes = {"routes": 1, "slots": len(self.ran), "block": 0, "frames": 1, "sets": 1}
        sizes |= {"references": self.bank.references, "line": REACH + self.bank.references}
        sizes |= {"two": 2, "ways": WAYS, "coefficients": 0}
        minds = Minds(sizes, batch=Batch(sizes, block=0), rates=rates)
        begin(minds, 0, self.bank.references)
        places = np.zeros(self.bank.queries, np.int64)
        beliefs = np.zeros((self.bank.queries, 2))
        tolerance = self.bank.tolerance
        table = minds.write()
        address = table.ctypes.data
        drive_route(address, self._runs, self.ran, self.truth, tolerance, places, beliefs)
        return places, beliefs

    def score(self, rates: Rates) -> tuple[float, float]:
        """Mean −log of the belief in the truth, and share of right places, where there is one."""
        places, beliefs = self.drive(rates)
        known = self.bank.truth.has_place
        loss = -np.log(np.maximum(beliefs[known, 1], LEAST))
        return float(loss.mean()), float(self.bank.truth.correct(places)[known].mean())


def score(drives: Sequence[Drive], rates: Rates, threads: Executor) -> tuple[float, float]:
    """Mean of the drives' scores: loss and accuracy. The kernels run without the GIL."""
    pairs = np.array(list(threads.map(lambda drive: drive.score(rates), drives)))
    return float(pairs[:, 0].mean()), float(pairs[:, 1].mean())


def activity(rng: np.random.Generator, bank: ScoreBank) -> NDArray[np.bool_]:
    """Which techniques run on each frame (Q, T): as selectors of several kinds would have it."""
    order, shape = np.argsort(bank.seconds), (bank.queries, len(bank.techniques))
    ran = np.zeros(shape, np.bool_)
    kind = rng.integers(5)
    if kind == 0:
        ran[:] = True
    elif kind in (1, 2):
        ran[:, order[:kind]] = True
    elif kind == 3:
        ran = rng.random(shape) < rng.choice((0.1, 0.3, 0.6))
    else:  # everything now and then
        ran |= (np.cumsum(rng.random(bank.queries) < 0.05) % 2 == 1)[:, None]
    ran[~ran.any(axis=1), order[0]] = True
    return ran
