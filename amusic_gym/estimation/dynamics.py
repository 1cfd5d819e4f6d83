"""One frame of a batch of routes, compiled: run techniques, correct (SIC), fuse (MuSIC), observe.

This is the only implementation of the environment's dynamics.
:class:`amusic_gym.envs.episode.Episodes` owns the arrays and calls :func:`step_routes` or
:func:`step_beliefs`; the single and the vector environment own an ``Episodes``. Every array has the
batch of N routes as its leading axis and S technique slots next
(:mod:`amusic_gym.estimation.records`).
"""

from __future__ import annotations

import math
from typing import Any

from amusic_gym.banks.rows import correlation, deviation, mean_at, prepare, row_at, scale_at, top_at
from amusic_gym.estimation.belief.places import log_odds, log_ratio
from amusic_gym.estimation.observation import SMOOTHING, USUAL_SMOOTHING, observe
from amusic_gym.estimation.records import LIVE, PAST_END, Outcome, Rules, State, batch_at
from amusic_gym.estimation.sic import (
    best_candidate,
    best_rival,
    candidate_at,
    diagonal_statistic,
    discount_of,
    first_best,
    push,
    ratio_of,
    weigh,
)
from amusic_gym.kernels.compiling import compiled, inner, spliced

IDLE_DECAY = 0.9995
"""Factor on p̂ and confidence per frame on which nothing ran.

An assumption about the robot, not a fit: where it moves on by exactly one place per frame, nothing
decays.
"""

SUPPORT_MEMORY = 0.98
"""Factor per frame on what a technique's last match counts for or against the prediction."""

RECENT_SMOOTHING = 0.1
"""Weight of the newest frame in the running mean of the similarity, which p̂ is made of."""

DOUBT = 0.5
"""A frame with p̂ below this is one of doubt."""

PLAN, PROCESS, SHOW = 1, 2, 4
"""Stages of a step: decide what runs, process what ran, write the outcome."""


@spliced
def correct_frame(
    state: State, rules: Rules, i: int, s: int, frame: int, own: int, fused: int, out: Outcome
) -> int:
    """Run SIC for one technique on a frame; statistics to ``state.values[s]``; winner's rank.

    ``own`` and ``fused`` are the technique's last match and the last prediction, moved on to the
    frame; −1 where there is none.
    """
    run = state.runs[i, s]
    state.carried[s, 0] = own if rules.carry else -1
    state.carried[s, 1] = fused if rules.carry else -1
    if not prepare(run, frame):
        out.routes[i].bad_row = 1 + s * state.routes[i].frames + frame
    sums, mark = state.sums[LIVE, i, s], state.marks[LIVE, i, s]
    push(sums, mark, run, state.ran[i, s], frame, rules.history, rules.gamma)
    counts, prefix, factors = state.counts[i, s], state.prefix[i, s], state.factors
    history, gamma, evidence = rules.history, rules.gamma, rules.evidence
    carried, values = state.carried[s], state.values[s]
    return best_candidate(
        sums, mark, run, counts, prefix, factors, frame, history, gamma, evidence, carried, values
    )


@inner
def store_result(state: State, tolerance: int, i: int, s: int, frame: int, winner: int) -> None:
    """Store the outcome of a technique's run in its slot."""
    slot, values = state.slots[i, s], state.values[s]
    top, carried = top_at(state.runs[i, s], frame), state.carried[s]
    slot.last_run = frame
    slot.place = candidate_at(top, carried, winner)
    slot.discount = discount_of(state.marks[LIVE, i, s])
    slot.weight = slot.discount
    slot.statistic = values[winner]
    slot.correction = values[winner] - values[0]
    rival = best_rival(values, top, carried, slot.place, tolerance)
    slot.rival = rival
    slot.margin = slot.statistic - rival if rival > -math.inf else 0.0


@inner
def load_result(state: State, i: int, s: int, frame: int) -> None:
    """Store a technique's result from the belief in its slot."""
    slot, known = state.slots[i, s], state.witnesses[i, s]
    slot.last_run = frame
    slot.place = known.place
    slot.statistic = known.statistic
    slot.correction = known.correction
    slot.margin = known.margin
    slot.trust = known.trust
    slot.sharpness = 0.25 * known.once + 0.5 * known.twice + known.fourfold
    slot.weight = known.weight
    slot.discount = 1.0
    slot.stored = known.said


@inner
def choose_runs(state: State, rules: Rules, i: int, action: Any, out: Outcome) -> None:
    """Decide which techniques run on the frame: the selection, the action, or the fallback."""
    slots = state.slots[i]
    selection = out.routes[i].happened
    cheapest, count = -1, 0
    for s in range(slots.size):
        if not slots[s].present:
            continue
        if out.slots[i, s].selected if selection else action[s]:
            out.slots[i, s].ran = True
            count += 1
        if cheapest < 0 or slots[s].seconds < slots[cheapest].seconds:
            cheapest = s
    if count == 0 and rules.allow_idle:
        out.routes[i].idle = True
    elif count == 0:
        out.slots[i, cheapest].ran = True
        out.routes[i].fallback = True


@inner
def note_runs(state: State, rules: Rules, i: int, out: Outcome) -> None:
    """Store what runs on the next frame, and its cost."""
    frame = state.routes[i].frame + 1
    ratio = ratio_of(rules.gamma, rules.evidence)
    for s in range(state.slots[i].size):
        slot = state.slots[i, s]
        slot.ran, slot.chosen = out.slots[i, s].ran, False
        if slot.present:
            state.ran[i, s, frame] = slot.ran
            counts, prefix = state.counts[i, s], state.prefix[i, s]
            weigh(counts, prefix, state.ran[i, s], frame, frame + 1, ratio)
            if slot.ran:
                out.routes[i].seconds += slot.seconds


@inner
def write_result(state: State, i: int, s: int, out: Outcome) -> None:
    """Copy a technique's result to the step output."""
    slot = state.slots[i, s]
    out.slots[i, s].place = slot.place
    out.slots[i, s].statistic = slot.statistic
    out.slots[i, s].correction = slot.correction


@spliced
def correct_techniques(state: State, rules: Rules, i: int, frame: int, out: Outcome) -> None:
    """Run SIC for the techniques that run on the frame."""
    for s in range(state.slots[i].size):
        slot = state.slots[i, s]
        if slot.ran:
            own = slot.place + frame - slot.last_run if slot.last_run >= 0 else -1
            prediction = state.routes[i].prediction
            fused = prediction + 1 if prediction >= 0 else -1
            winner = correct_frame(state, rules, i, s, frame, own, fused, out)
            store_result(state, state.routes[i].tolerance, i, s, frame, winner)
            if rules.block:
                state.places[i, s, frame] = slot.place
            write_result(state, i, s, out)


@spliced
def load_results(state: State, i: int, frame: int, out: Outcome) -> None:
    """Load the belief's results of the techniques that run on the frame."""
    for s in range(state.slots[i].size):
        if state.slots[i, s].ran:
            if not prepare(state.runs[i, s], frame):
                out.routes[i].bad_row = 1 + s * state.routes[i].frames + frame
            load_result(state, i, s, frame)
            write_result(state, i, s, out)


@inner
def sigmoid(logit: float) -> float:
    """1 / (1 + exp(−logit))."""
    p: float = 1.0 / (1.0 + math.exp(-min(max(logit, -30.0), 30.0)))
    return p


@inner
def logit_of(probability: float) -> float:
    """log(p / (1 − p)), from −30 to 30 as :func:`estimate` gives it."""
    logit: float = math.log(max(probability, 1e-300) / (1.0 - probability))
    return min(max(logit, -30.0), 30.0)


@inner
def weigh_others(state: State, i: int, chosen: int, frame: int) -> None:
    """Weigh what the techniques that were not chosen say of the prediction.

    A technique counts less the longer ago it ran, and less the more its row was like the chosen
    one's, where they last ran together; a constant row says nothing at all. ``heard`` is the
    highest weight of all, ``support`` that of those whose last match, moved on, is the prediction;
    both in [0, 1].
    """
    slots, route = state.slots[i], state.routes[i]
    route.heard, route.support = 0.0, 0.0
    for s in range(slots.size):
        slot = slots[s]
        if s == chosen or slot.last_run < 0 or not slot.present:
            continue
        if slot.ran:
            one, other = state.runs[i, chosen], state.runs[i, s]
            slot.likeness = correlation(one, frame, other, frame, 0)
            if scale_at(one, frame)[0] == 0.0 or scale_at(other, frame)[0] == 0.0:
                slot.likeness = 1.0  # a constant row says nothing
        age = frame - slot.last_run
        weight = (1.0 - min(max(slot.likeness, 0.0), 1.0)) * SUPPORT_MEMORY**age
        route.heard = max(route.heard, weight)
        if abs(slot.place + age - route.prediction) <= route.tolerance:
            route.support = max(route.support, weight)


@inner
def trust_highest(state: State, i: int, out: Outcome) -> int:
    """Choose the technique of the highest statistic (MuSIC, III-B)."""
    slots, statistics = state.slots[i], state.scratch
    for s in range(slots.size):
        statistics[s] = slots[s].statistic * slots[s].discount if slots[s].ran else -math.inf
    chosen = first_best(statistics, slots.size)
    slots[chosen].chosen = True
    out.routes[i].technique = chosen
    return chosen


@inner
def set_prediction(route: Any, place: int) -> None:
    """Make ``place`` the prediction."""
    route.continues = 1.0 if route.prediction >= 0 and place == route.prediction + 1 else 0.0
    route.track = route.track + 0.1 if route.continues > 0.0 else 0.0
    route.prediction = place


@inner
def fuse(state: State, i: int, frame: int, out: Outcome) -> bool:
    """Trust the technique of the highest statistic (MuSIC, III-B).

    Returns:
        Whether a candidate beyond the tolerance stands against the prediction.
    """
    slots, route = state.slots[i], state.routes[i]
    chosen = trust_highest(state, i, out)
    place = slots[chosen].place
    rival = -math.inf
    for s in range(slots.size):
        if not slots[s].ran:
            continue
        best = slots[s].rival
        if slots[s].place != place:  # else it is that of the technique itself
            top = top_at(state.runs[i, s], frame)
            best = best_rival(state.values[s], top, state.carried[s], place, route.tolerance)
        rival = max(rival, best * slots[s].discount)
    set_prediction(route, place)
    route.confidence = slots[chosen].statistic
    discounted = slots[chosen].statistic * slots[chosen].discount
    route.margin = discounted - rival if rival > -math.inf else 0.0
    weigh_others(state, i, chosen, frame)
    return rival > -math.inf


@inner
def estimate(state: State, rules: Rules, i: int, has_rival: bool, out: Outcome) -> None:
    """Estimate the correctness p̂ of the prediction: see amusic_gym.estimation.calibration."""
    route, slot, b = state.routes[i], state.slots[i, out.routes[i].technique], rules.calibration
    first, late = (0, 6) if has_rival else (8, 11)
    drive = b[first] + b[first + 1] * math.asinh(slot.statistic * slot.discount)
    drive += b[first + 2] * math.log1p(10.0 * route.track)
    if has_rival:
        drive += b[3] * route.heard + b[4] * route.support + b[5] * math.asinh(route.margin)
    route.recent += RECENT_SMOOTHING * (slot.support - route.recent)
    recent = b[late] + b[late + 1] * math.asinh(route.recent)
    route.p_correct = sigmoid(drive) * sigmoid(recent)
    route.logit = logit_of(route.p_correct)


@inner
def believe(state: State, rules: Rules, i: int, out: Outcome) -> None:
    """Take the place whose surroundings hold most of the belief; estimate correctness.

    The technique trusted is the one of the highest statistic, as in MuSIC; the place is what all
    that ran say together.
    """
    route, mind, b = state.routes[i], state.minds[i], rules.calibration
    known = route.prediction >= 0
    for s in range(state.slots[i].size):
        known = known or state.slots[i, s].ran
    if not known:
        return
    set_prediction(route, mind.place)
    route.margin = log_ratio(mind.share, mind.rival)
    route.said = mind.said
    if mind.heard > 0:
        route.said_mean += SMOOTHING * (mind.said / mind.heard - route.said_mean)
    logit = b[0] + b[1] * log_odds(mind.share) + b[2] * route.margin
    logit += b[3] * route.said + b[4] * route.said_mean
    route.confidence = min(max(logit, -30.0), 30.0)
    route.logit = route.confidence
    route.p_correct = sigmoid(logit)
    route.steady, route.strange = mind.steady, mind.strange
    if not out.routes[i].idle:
        trust_highest(state, i, out)


@inner
def predict_only(route: Any) -> None:
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
def stored_statistic(state: State, rules: Rules, i: int, s: int, place: int) -> float:
    """Statistic that a place of the technique's last run had."""
    if place < 0:
        return 0.0
    sums, mark, run = state.sums[LIVE, i, s], state.marks[LIVE, i, s], state.runs[i, s]
    counts, prefix, factors = state.counts[i, s], state.prefix[i, s], state.factors
    frame, history, gamma = state.slots[i, s].last_run, rules.history, rules.gamma
    return diagonal_statistic(
        sums, mark, run, counts, prefix, factors, frame, history, gamma, rules.evidence, place
    )


@inner
def relate(state: State, rules: Rules, i: int, frame: int) -> None:
    """Relate every technique's last run to the fused prediction (features of the observation)."""
    slots, route = state.slots[i], state.routes[i]
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
        if not rules.belief:
            slot.stored = stored_statistic(state, rules, i, s, route.prediction - age)
        agreeing += slot.agrees
        if slot.ran:
            run = state.runs[i, s]
            z = deviation(row_at(run, frame)[route.prediction], mean_at(run, frame)[0])
            slot.support = z * scale_at(run, frame)[0]
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


@spliced
def finish(state: State, rules: Rules, i: int, frame: int, out: Outcome) -> None:
    """Finish the route's memory of the frame."""
    route = state.routes[i]
    if out.routes[i].idle:
        out.routes[i].technique = -1
    chosen = out.routes[i].technique
    out.routes[i].similarity = state.slots[i, chosen].support if chosen >= 0 else 0.0
    route.frame = frame
    if rules.block and not rules.belief:
        state.predictions[i, frame] = route.prediction
    route.since_doubt = 0.0 if route.p_correct < DOUBT else route.since_doubt + 1.0
    route.p_correct_mean += SMOOTHING * (route.p_correct - route.p_correct_mean)
    if route.spent >= 0.0:
        out.routes[i].seconds = route.spent
    route.compute = out.routes[i].seconds / route.total_seconds
    route.compute_mean += SMOOTHING * (route.compute - route.compute_mean)


@inner
def show_route(state: State, i: int, out: Outcome) -> None:
    """Copy what is known of a route to the outcome."""
    route, slots = state.routes[i], state.slots[i]
    for s in range(slots.size):
        out.slots[i, s].present = slots[s].present
        out.slots[i, s].run_seconds = slots[s].seconds
    out.routes[i].route = route.bank
    out.routes[i].compute_weight = route.compute_weight
    out.routes[i].ended = route.frame + 1 >= route.frames
    out.routes[i].frame = route.frame
    out.routes[i].prediction = route.prediction
    out.routes[i].confidence = route.confidence
    out.routes[i].margin = route.margin
    out.routes[i].p_correct = route.p_correct
    out.routes[i].compute = route.compute
    observe(route, slots, out.observation[i])


@inner
def plan(state: State, rules: Rules, active: Any, actions: Any, out: Outcome) -> None:
    """Decide what runs on the next frame of every active route.

    A route that has ended, which an error may have hidden from whoever steps it, stays as it is.
    """
    for i in range(active.size):
        if active[i] and state.routes[i].frame + 1 >= state.routes[i].frames:
            active[i] = False
            out.routes[i].bad_row = PAST_END
        if active[i]:
            choose_runs(state, rules, i, actions[i], out)
            note_runs(state, rules, i, out)


@inner
def show(state: State, active: Any, out: Outcome) -> int:
    """Write what is known of every route to the outcome.

    Returns:
        Number of routes on which something is wrong; their ``bad_row`` tells what.
    """
    bad_rows = 0
    for i in range(active.size):
        if not active[i]:
            out.routes[i].technique = -1
        bad_rows += out.routes[i].bad_row != 0
        show_route(state, i, out)
    return bad_rows


@compiled
def step_routes(address: int, stages: int) -> int:
    """Take the active routes through stages of their next frame, with SIC and MuSIC.

    The plan can be made apart, because a live route computes the rows that it names before they
    are processed. A selection comes before (:func:`amusic_gym.estimation.selection.select_routes`).

    Args:
        address: of a table of the layout ``BATCH``, with its outcome zeroed before the step.
        stages: ``PLAN``, ``PROCESS`` and ``SHOW``, added up.

    Returns:
        Number of routes on which a row that ran is not finite, or that had ended; their ``bad_row``
        tells which.
    """
    batch = batch_at(address)
    state, rules, active, out = batch.state, batch.rules, batch.active, batch.out
    if stages & PLAN:
        plan(state, rules, active, batch.actions, out)
    if stages & PROCESS:
        for i in range(active.size):
            if active[i]:
                frame = state.routes[i].frame + 1
                correct_techniques(state, rules, i, frame, out)
                idle, has_rival = out.routes[i].idle, False
                if idle:
                    predict_only(state.routes[i])
                else:
                    has_rival = fuse(state, i, frame, out)
                relate(state, rules, i, frame)
                if not idle:
                    estimate(state, rules, i, has_rival, out)
                finish(state, rules, i, frame, out)
    return show(state, active, out) if stages & SHOW else 0


@compiled
def step_beliefs(address: int, stages: int) -> int:
    """As :func:`step_routes` with the statistic ``belief``, which hears the rows after the plan.

    Apart, so that neither has to be compiled for the other.
    """
    batch = batch_at(address)
    state, rules, active, out = batch.state, batch.rules, batch.active, batch.out
    if stages & PLAN:
        plan(state, rules, active, batch.actions, out)
    if stages & PROCESS:
        for i in range(active.size):
            if active[i]:
                frame = state.routes[i].frame + 1
                load_results(state, i, frame, out)
                believe(state, rules, i, out)
                relate(state, rules, i, frame)
                finish(state, rules, i, frame, out)
    return show(state, active, out) if stages & SHOW else 0
