"""What every estimator does with a prediction, compiled.

The estimators differ in how they come to a place and to its correctness; what a frame's runs say
of the prediction, and what the route remembers of it, is the same.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import prepared_at, top_at, z_at
from amusic_gym.estimation.batch import Batch, RouteState, SlotState
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

LEAVES, RETURNS = 0.01, 0.02
"""Probability per frame of leaving the map, and of coming back."""

LEAST_USUAL = 0.5
"""A place has at least this similarity to be told from places off the map."""

CONFIRMED_PRIOR, CONFIRMED_PRIOR_RUNS = 0.3, 3.0
"""Share of confirming runs before the first, and the number of runs that it is worth."""

MOST_CONFIRMED, LEAST_ABOVE_CHANCE = 0.95, 0.02
"""Bounds of the share of confirming runs on the map: the second above that off the map."""

MOST_RATIO = 4.0
"""Bound on the log-likelihood ratio of a similarity, and on that of a row's best place."""

RATIO_SHARE = 0.5
"""Weight of the two: neighbouring rows, and the two of one row, repeat each other."""

SURE_OF_MAP = 12.0
"""Bound on the log-odds of being on the map."""


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


@inner
def map_likelihood(slot: SlotState, route: RouteState) -> float:
    """Log-likelihood ratio of a run's row: at the prediction to off the map.

    Of the similarity: unit normal about what is usual for the technique, or about 0. Of the row's
    own best place: at the prediction as often as usual, or by chance.
    """
    usual = max(slot.support_usual, LEAST_USUAL)
    support = usual * (slot.support - 0.5 * usual)
    chance = min((2.0 * route.tolerance + 1.0) / route.references, 0.5)
    runs = min(slot.runs, 1.0 / USUAL_SMOOTHING)
    share = CONFIRMED_PRIOR * CONFIRMED_PRIOR_RUNS + runs * slot.confirmation_usual
    share /= CONFIRMED_PRIOR_RUNS + runs
    share = min(max(share, chance + LEAST_ABOVE_CHANCE), MOST_CONFIRMED)
    confirmed = share / chance if slot.confirms > 0.0 else (1.0 - share) / (1.0 - chance)
    ratio: float = min(max(support, -MOST_RATIO), MOST_RATIO)
    ratio += min(max(math.log(confirmed), -MOST_RATIO), MOST_RATIO)
    return RATIO_SHARE * ratio


@inner
def update_on_map(route: RouteState, most: float, least: float) -> None:
    """Update the log-odds of being on the map by the strongest ratios for it and against it.

    Not by all of them: a copy of a technique has no say of its own.
    """
    before = sigmoid(route.on_map)
    p_on_map = before * (1.0 - LEAVES) + (1.0 - before) * RETURNS
    log_odds = logit_of(p_on_map) + most + least
    route.on_map = min(max(log_odds, -SURE_OF_MAP), SURE_OF_MAP)


@apart
def relate(batch: Batch, i: int, frame: int) -> None:
    """Relate every technique's last run to the prediction, and tell whether that is on the map."""
    slots, route = batch.slots[i], batch.routes[i]
    present, agreeing = 0, 0.0
    most, least = 0.0, 0.0
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
            near = abs(top_at(run, frame)[0] - route.prediction) <= route.tolerance
            slot.confirms = 1.0 if near else 0.0
            if prepared_at(run, frame).scale > 0.0:
                ratio = map_likelihood(slot, route)
                most, least = max(most, ratio), min(least, ratio)
            slot.runs += 1.0
            usual = max(USUAL_SMOOTHING, 1.0 / slot.runs)
            slot.support_usual += usual * (slot.support - slot.support_usual)
            slot.confirmation_usual += usual * (slot.confirms - slot.confirmation_usual)
            slot.support_mean += SMOOTHING * (slot.support - slot.support_mean)
            slot.confirmation += SMOOTHING * (slot.confirms - slot.confirmation)
            if near:
                route.since_confirmed = 0.0
            slot.agreement += SMOOTHING * (slot.agrees - slot.agreement)
    update_on_map(route, most, least)
    route.agreeing = agreeing / present
    route.similarity = slots[route.technique].support if route.technique >= 0 else 0.0
