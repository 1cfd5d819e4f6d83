"""One frame of SIC and MuSIC for a batch of routes, compiled (A-MuSIC, III-A and III-B)."""

from __future__ import annotations

import math

from amusic_gym.banks.rows import correlation, prepare, scale_at, top_at
from amusic_gym.estimation.prediction import (
    choose_technique,
    logit_of,
    predict_only,
    relate,
    remember,
    set_prediction,
    sigmoid,
)
from amusic_gym.estimation.sic.state import LIVE, SICState, state_at
from amusic_gym.estimation.sic.statistics import (
    best_candidate,
    best_rival,
    candidate_at,
    ratio_of,
    score_places,
    weigh,
)
from amusic_gym.estimation.sic.sums import discount_of, push
from amusic_gym.kernels.compiling import compiled, inner, spliced

SUPPORT_MEMORY = 0.98
"""Factor per frame on what a technique's last match counts for or against the prediction."""


@spliced
def correct_frame(state: SICState, i: int, s: int, frame: int, own: int, fused: int) -> int:
    """Run SIC for one technique on a frame; statistics to ``state.values[s]``; winner's rank.

    ``own`` and ``fused`` are the technique's last match and the last prediction, moved on to the
    frame; −1 where there is none.
    """
    batch = state.batch
    run = batch.runs[i, s]
    state.carried[s, 0] = own if state.carry else -1
    state.carried[s, 1] = fused if state.carry else -1
    if not prepare(run, frame):
        batch.routes[i].bad_row = 1 + s * batch.routes[i].frames + frame
    sums, mark = state.sums[LIVE, i, s], state.marks[LIVE, i, s]
    push(sums, mark, run, batch.ran[i, s], frame, state.history, state.gamma)
    return best_candidate(state, i, s, frame)


@inner
def store_result(state: SICState, i: int, s: int, frame: int, winner: int) -> None:
    """Store the outcome of a technique's run in its slot."""
    slot, values = state.batch.slots[i, s], state.values[s]
    top, carried = top_at(state.batch.runs[i, s], frame), state.carried[s]
    slot.last_run = frame
    slot.place = candidate_at(top, carried, winner)
    slot.discount = discount_of(state.marks[LIVE, i, s])
    slot.weight = slot.discount
    slot.statistic = values[winner]
    slot.correction = values[winner] - values[0]
    slot.rival = best_rival(values, top, carried, slot.place, state.batch.routes[i].tolerance)
    slot.margin = slot.statistic - slot.rival if slot.rival > -math.inf else 0.0


@inner
def weigh_runs(state: SICState, i: int, s: int, frame: int) -> None:
    """Extend what weights are made of by a frame."""
    ratio, ran = ratio_of(state.gamma, state.evidence), state.batch.ran[i, s]
    weigh(state.counts[i, s], state.prefix[i, s], ran, frame, frame + 1, ratio)


@spliced
def correct_techniques(state: SICState, i: int, frame: int) -> None:
    """Run SIC for the techniques that run on the frame."""
    batch = state.batch
    for s in range(batch.slots[i].size):
        slot = batch.slots[i, s]
        if slot.present:
            weigh_runs(state, i, s, frame)
        if slot.ran:
            own = slot.place + frame - slot.last_run if slot.last_run >= 0 else -1
            prediction = batch.routes[i].prediction
            fused = prediction + 1 if prediction >= 0 else -1
            winner = correct_frame(state, i, s, frame, own, fused)
            store_result(state, i, s, frame, winner)
            if batch.block:
                state.places[i, s, frame] = slot.place


@inner
def weigh_others(state: SICState, i: int, frame: int) -> None:
    """Weigh what the techniques that were not chosen say of the prediction.

    A technique counts less the longer ago it ran, and less the more its row was like the chosen
    one's, where they last ran together; a constant row says nothing at all. ``heard`` is the
    highest weight of all, ``support`` that of those whose last match, moved on, is the prediction;
    both in [0, 1].
    """
    slots, route = state.batch.slots[i], state.batch.routes[i]
    chosen = route.technique
    route.heard, route.support = 0.0, 0.0
    for s in range(slots.size):
        slot = slots[s]
        if s == chosen or slot.last_run < 0 or not slot.present:
            continue
        if slot.ran:
            one, other = state.batch.runs[i, chosen], state.batch.runs[i, s]
            slot.likeness = correlation(one, frame, other, frame, 0)
            if scale_at(one, frame)[0] == 0.0 or scale_at(other, frame)[0] == 0.0:
                slot.likeness = 1.0  # a constant row says nothing
        age = frame - slot.last_run
        weight = (1.0 - min(max(slot.likeness, 0.0), 1.0)) * SUPPORT_MEMORY**age
        route.heard = max(route.heard, weight)
        if abs(slot.place + age - route.prediction) <= route.tolerance:
            route.support = max(route.support, weight)


@inner
def fuse(state: SICState, i: int, frame: int) -> bool:
    """Take the match of the technique with the highest statistic (MuSIC, III-B).

    Returns:
        Whether a candidate beyond the tolerance stands against the prediction.
    """
    slots, route = state.batch.slots[i], state.batch.routes[i]
    chosen = choose_technique(state.batch, i)
    place = slots[chosen].place
    rival = -math.inf
    for s in range(slots.size):
        if not slots[s].ran:
            continue
        best = slots[s].rival
        if slots[s].place != place:  # else it is that of the technique itself
            top = top_at(state.batch.runs[i, s], frame)
            best = best_rival(state.values[s], top, state.carried[s], place, route.tolerance)
        rival = max(rival, best * slots[s].discount)
    set_prediction(route, place)
    route.confidence = slots[chosen].statistic
    discounted = slots[chosen].statistic * slots[chosen].discount
    route.margin = discounted - rival if rival > -math.inf else 0.0
    weigh_others(state, i, frame)
    return rival > -math.inf


@inner
def store_fused(state: SICState, i: int, frame: int) -> None:
    """Store the statistic that the diagonal of the prediction had at each technique's last run."""
    slots, route = state.batch.slots[i], state.batch.routes[i]
    for s in range(slots.size):
        slot = slots[s]
        if slot.present and slot.last_run >= 0 and route.prediction >= 0:
            place = route.prediction - (frame - slot.last_run)
            slot.stored = 0.0
            if place >= 0:
                carried, values = state.carried[s], state.values[s]
                carried[0] = place
                score_places(state, i, s, slot.last_run, carried, 1, values)
                slot.stored = values[0]


@inner
def estimate_correctness(state: SICState, i: int, has_rival: bool) -> None:
    """Estimate the correctness p̂ of the prediction: see amusic_gym.estimation.calibration."""
    route, b = state.batch.routes[i], state.calibration
    slot = state.batch.slots[i, route.technique]
    first, late = (0, 6) if has_rival else (8, 11)
    drive = b[first] + b[first + 1] * math.asinh(slot.statistic * slot.discount)
    drive += b[first + 2] * math.log1p(10.0 * route.track)
    if has_rival:
        drive += b[3] * route.heard + b[4] * route.support + b[5] * math.asinh(route.margin)
    route.p_correct = sigmoid(drive) * sigmoid(b[late] + b[late + 1] * route.on_map)
    route.logit = logit_of(route.p_correct)


@compiled
def update_routes(address: int) -> None:
    """Take the active routes' next frame: correct what ran, fuse, and estimate correctness.

    Args:
        address: of the words of a :class:`~amusic_gym.estimation.sic.state.SICState`.
    """
    state = state_at(address)
    batch = state.batch
    for i in range(batch.active.size):
        if batch.active[i]:
            route = batch.routes[i]
            frame = route.frame + 1
            has_rival = False
            correct_techniques(state, i, frame)
            if route.idle:
                predict_only(route)
            else:
                has_rival = fuse(state, i, frame)
            store_fused(state, i, frame)
            relate(batch, i, frame)
            if not route.idle:
                estimate_correctness(state, i, has_rival)
            if batch.block:
                state.predictions[i, frame] = route.prediction
            remember(route)
            route.frame = frame


@compiled
def weigh_frame(address: int, frame: int) -> None:
    """Extend what weights are made of by a frame of a batch of one technique."""
    weigh_runs(state_at(address), 0, 0, frame)


@compiled
def correct_one(address: int, frame: int, own: int, fused: int) -> int:
    """As :func:`correct_frame`, of a batch of one technique (:class:`SIC`)."""
    return correct_frame(state_at(address), 0, 0, frame, own, fused)
