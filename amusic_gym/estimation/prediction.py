"""What every estimator does with a prediction, compiled.

The estimators differ in how they come to a place and to its correctness; what a frame's runs say
of the prediction, and what the route remembers of it, is the same.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import top_at, z_at
from amusic_gym.estimation.batch import Batch, RouteState
from amusic_gym.kernels.compiling import apart, inner

SMOOTHING = 0.2
"""Weight of the newest value in every running mean of the observation."""

USUAL_SMOOTHING = 0.02
"""Weight of the newest value in what is usual for a technique; of the k-th at least 1 / k."""

RELATIVE_TIE = 1e-9
ABSOLUTE_TIE = 1e-12
"""Statistics this close to each other are equal."""

IDLE_DECAY = 0.9995
"""Factor on p̂ and confidence per frame on which nothing ran.

An assumption about the robot, not a fit: where it moves on by exactly one place per frame, nothing
decays.
"""


@inner
def first_near(values: NDArray[np.float64], best: float, size: int) -> int:
    """Index of the first value that is as good as ``best``, the highest of them."""
    floor = best - (ABSOLUTE_TIE + RELATIVE_TIE * abs(best))
    for i in range(size):
        if values[i] >= floor:
            return i
    return 0


@inner
def choose_technique(batch: Batch, i: int) -> int:
    """Choose the technique of the highest discounted statistic (MuSIC, III-B)."""
    slots, statistics, best = batch.slots[i], batch.scratch, -math.inf
    for s in range(slots.size):
        statistics[s] = slots[s].statistic * slots[s].discount if slots[s].ran else -math.inf
        best = max(best, statistics[s])
    chosen = first_near(statistics, best, slots.size)
    slots[chosen].chosen = True
    batch.routes[i].technique = chosen
    return chosen


@inner
def sigmoid(logit: float) -> float:
    """1 / (1 + exp(−logit))."""
    p: float = 1.0 / (1.0 + math.exp(-min(max(logit, -30.0), 30.0)))
    return p


@inner
def logit_of(probability: float) -> float:
    """log(p / (1 − p)), from −30 to 30."""
    logit: float = math.log(max(probability, 1e-300) / (1.0 - probability))
    return min(max(logit, -30.0), 30.0)


@inner
def set_prediction(route: RouteState, place: int) -> None:
    """Make ``place`` the prediction."""
    route.continues = 1.0 if route.prediction >= 0 and place == route.prediction + 1 else 0.0
    route.track = route.track + 0.1 if route.continues > 0.0 else 0.0
    route.prediction = place


@inner
def predict_only(route: RouteState) -> None:
    """Move the prediction on by one place when nothing ran."""
    moves = 0 <= route.prediction < route.references - 1
    route.continues = 1.0 if moves else 0.0
    route.track = route.track + 0.1 if moves else 0.0
    route.prediction += moves
    route.margin = 0.0
    route.confidence *= IDLE_DECAY
    route.p_correct *= IDLE_DECAY
    if route.prediction >= 0:
        route.logit = logit_of(route.p_correct)


@apart
def relate(batch: Batch, i: int, frame: int) -> None:
    """Relate every technique's last run to the prediction (features of the observation)."""
    slots, route = batch.slots[i], batch.routes[i]
    present, agreeing = 0, 0.0
    route.since_confirmed += 1.0
    for s in range(slots.size):
        slot = slots[s]
        if not slot.present:
            continue
        present += 1
        if slot.last_run < 0 or route.prediction < 0:
            continue
        age = frame - slot.last_run
        slot.agrees = 1.0 if abs(slot.place + age - route.prediction) <= route.tolerance else 0.0
        agreeing += slot.agrees
        if slot.ran:
            run = batch.runs[i, s]
            slot.support = z_at(run, frame, route.prediction)
            slot.support_mean += SMOOTHING * (slot.support - slot.support_mean)
            slot.runs += 1.0
            usual = max(USUAL_SMOOTHING, 1.0 / slot.runs)
            slot.support_usual += usual * (slot.support - slot.support_usual)
            near = abs(top_at(run, frame)[0] - route.prediction) <= route.tolerance
            slot.confirms = 1.0 if near else 0.0
            slot.confirmation += SMOOTHING * (slot.confirms - slot.confirmation)
            if near:
                route.since_confirmed = 0.0
            slot.agreement += SMOOTHING * (slot.agrees - slot.agreement)
    route.agreeing = agreeing / present
    route.similarity = slots[route.technique].support if route.technique >= 0 else 0.0
