"""The Bayes filter over places, frame by frame.

Functions that kernels call get the batch's memory, a set of it (live or lagged), a route and a
frame. Those that Python calls get the address of the words of a
:class:`~amusic_gym.estimation.belief.state.BeliefState`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import prepare, prepared_at, top_at
from amusic_gym.estimation.belief.agreement import learn_likenesses, weigh_techniques
from amusic_gym.estimation.belief.model import (
    ACQUAINTED,
    LIVELY,
    MODES,
    NOT_STANDING,
    STAND,
    STEADY,
    STILL,
)
from amusic_gym.estimation.belief.motion import add_modes, predict
from amusic_gym.estimation.belief.places import (
    first_highest,
    log_odds,
    log_ratio,
    marginalise,
    single_technique_posterior,
)
from amusic_gym.estimation.belief.rows import (
    ONE,
    ZERO,
    highest,
    logarithm,
    power,
    row_likelihood,
    single,
    total,
)
from amusic_gym.estimation.belief.state import LAGGED, LIVE, BeliefState, restart, state_at
from amusic_gym.estimation.prediction import (
    SMOOTHING,
    choose_technique,
    logit_of,
    relate,
    set_prediction,
    sigmoid,
)
from amusic_gym.kernels.compiling import apart, compiled, inner, spliced, without_gil


@apart
def read_rows(state: BeliefState, which: int, i: int, frame: int) -> int:
    """Turn the rows of a frame into likelihoods; how many there are.

    Leaves what each alone makes of the predicted belief, ``prior``, in its record, and a weight of
    1 for each that is not constant, 0 for all others.
    """
    runs, ran, count = state.batch.runs[i], state.batch.ran[i], 0
    size, tolerance = state.batch.routes[i].references, state.batch.routes[i].tolerance
    for s in range(runs.size):
        state.weights[s] = 0.0
        if not ran[s, frame]:
            continue
        count += 1
        known, likelihood = state.techniques[which, i, s], state.likelihoods[s]
        if prepared_at(runs[s], frame).scale > 0.0:
            hub, variance = state.hubs[which, i, s], state.variances[which, i, s]
            row_likelihood(known, runs[s], frame, hub, variance, likelihood)
            state.weights[s] = 1.0
        else:
            known.news = 0.0
            for place in range(size):
                likelihood[place] = ONE
        top = top_at(runs[s], frame)[0]
        single_technique_posterior(state, known, s, top, size, tolerance)
    return count


@apart
def take_logs(values: NDArray[np.float32], size: int, out: NDArray[np.float32]) -> None:
    """Write the logarithms (R,) of positive values to ``out``."""
    for place in range(size):
        out[place] = logarithm(values[place])


@apart
def multiply(state: BeliefState, size: int, out: NDArray[np.float32]) -> None:
    """Write the product (R,) of the likelihoods, each to the power of its weight, to ``out``.

    The highest is 1.
    """
    for place in range(size):
        out[place] = ZERO
    for s in range(state.weights.size):
        if state.weights[s] > 0.0:
            logs, weight = state.logs[s], single(state.weights[s])
            for place in range(size):
                out[place] += weight * logs[place]
    top = highest(out, size)
    for place in range(size):
        out[place] = power(out[place] - top)


@apart
def fuse(state: BeliefState, which: int, i: int, size: int, out: NDArray[np.float32]) -> None:
    """Write the likelihood (R,) by all rows of a frame to ``out``, and find their weights."""
    useful, only = 0, 0
    for s in range(state.weights.size):
        if state.weights[s] > 0.0:
            useful, only = useful + 1, s
    if useful < 2:
        for place in range(size):
            out[place] = state.likelihoods[only, place] if useful else ONE
    else:
        for s in range(state.weights.size):
            if state.weights[s] > 0.0:
                take_logs(state.likelihoods[s], size, state.logs[s])
        likenesses, likeliest = state.likenesses[which, i], first_highest(state.prior, size)
        learn_likenesses(likenesses, state.logs, state.weights, state.sums, size, likeliest)
        weigh_techniques(likenesses, state.weights, state.sums)
        multiply(state, size, out)


@inner
def standing(state: BeliefState, which: int, i: int) -> float:
    """How much likelier the news of a frame's rows is if the robot stands; 1 if none can tell."""
    least = math.inf
    for s in range(state.weights.size):
        known = state.techniques[which, i, s]
        if state.weights[s] > 0.0 and known.rows > ACQUAINTED and known.usual > LIVELY:
            least = min(least, max(STAND * (STILL - known.change), NOT_STANDING))
    return math.exp(least) if least < math.inf else 1.0


@spliced
def filter_frame(state: BeliefState, which: int, i: int, frame: int) -> None:
    """Take the frame after the last into a belief: what ran on it, and that it passed.

    The rows of what ran are prepared.
    """
    route, modes, joint = state.beliefs[which, i], state.modes[which, i], state.joint
    size, tolerance = state.batch.routes[i].references, state.batch.routes[i].tolerance
    if frame > 0:
        predict(modes, size, joint, state.lines[0])
    route.frame = frame
    add_modes(modes, MODES, size, state.prior)
    route.rows = read_rows(state, which, i, frame)
    factor = state.windows
    stood = single(standing(state, which, i) - 1.0)
    for place in range(size):
        more = stood * modes[0, place]
        modes[0, place] += more
        state.prior[place] += more
    fuse(state, which, i, size, factor)
    for place in range(size):
        joint[place] = state.prior[place] * factor[place]
    whole = single(1.0 / total(joint, size))
    for place in range(size):
        factor[place] *= whole
    for mode in range(MODES):
        row = modes[mode]
        for place in range(size):
            row[place] *= factor[place]
    route.p_steady = min(total(modes[STEADY], size), 1.0)
    marginalise(state, route, size, tolerance)
    route.log_likelihood = 0.0
    for s in range(state.weights.size):
        if state.batch.ran[i, s, frame]:
            known = state.techniques[which, i, s]
            known.weight = state.weights[s]
            known.log_likelihood = math.log(state.likelihoods[s, route.place])
            route.log_likelihood += known.weight * known.log_likelihood


@spliced
def prepare_frame(state: BeliefState, i: int, frame: int) -> None:
    """Prepare the rows of what ran on a frame."""
    for s in range(state.weights.size):
        if state.batch.ran[i, s, frame]:
            prepare(state.batch.runs[i, s], frame)


@without_gil
def filter_routes(address: int) -> None:
    """Take the next frame of every active route into its belief."""
    state = state_at(address)
    for i in range(state.batch.active.size):
        if state.batch.active[i]:
            filter_frame(state, LIVE, i, state.batch.routes[i].frame + 1)


@compiled
def prepare_rows(address: int) -> None:
    """Prepare the rows that :func:`filter_routes` will need: several routes may share them."""
    state = state_at(address)
    for i in range(state.batch.active.size):
        if state.batch.active[i]:
            prepare_frame(state, i, state.batch.routes[i].frame + 1)


@spliced
def run_block(state: BeliefState, i: int, first: int, stop: int) -> None:
    """Go through the frames from ``first`` to before ``stop`` with every row of route ``i``."""
    batch = state.batch
    ran, slots = batch.ran[i], batch.slots[i]
    for s in range(slots.size):
        for frame in range(first, stop):
            if slots[s].present and not ran[s, frame]:
                slots[s].late_runs += 1
                ran[s, frame] = True
    restart(state, i)
    for frame in range(first, stop):
        for s in range(slots.size):
            if slots[s].present and not prepare(batch.runs[i, s], frame):
                batch.routes[i].bad_row = 1 + s * batch.routes[i].frames + frame
        filter_frame(state, LIVE, i, frame)
        for s in range(slots.size):
            known = state.techniques[LIVE, i, s]
            statistic = known.statistic if slots[s].present else -math.inf
            batch.statistics[i, frame - first, s] = statistic
            batch.corrections[i, s, frame - first] = known.correction
    for s in range(slots.size):
        if slots[s].present:
            load_result(state, i, s, stop - 1)


@compiled
def look_back(address: int) -> None:
    """Run all techniques on the last frames of the routes that want it, after the fact.

    The belief before that block is kept apart, and so is brought up to it first; then the block is
    gone through again with every row.
    """
    state = state_at(address)
    batch = state.batch
    for i in range(batch.wanted.size):
        stop = batch.routes[i].frame + 1
        first = max(0, stop - batch.block)
        if batch.wanted[i] or batch.lagging[i]:
            for frame in range(state.beliefs[LAGGED, i].frame + 1, first):
                prepare_frame(state, i, frame)
                filter_frame(state, LAGGED, i, frame)
        if batch.wanted[i]:
            run_block(state, i, first, stop)


@inner
def load_result(state: BeliefState, i: int, s: int, frame: int) -> None:
    """Store a technique's result in its slot."""
    slot, known = state.batch.slots[i, s], state.techniques[LIVE, i, s]
    slot.last_run = frame
    slot.place = known.place
    slot.statistic = known.statistic
    slot.correction = known.correction
    slot.margin = known.margin
    slot.weight = known.weight * known.news
    slot.discount = 1.0
    slot.stored = known.log_likelihood


@inner
def take_place(state: BeliefState, i: int) -> None:
    """Take the place whose window holds most of the belief.

    The technique trusted is the one of the highest statistic, as in MuSIC; the place is what all
    that ran say together.
    """
    route, belief = state.batch.routes[i], state.beliefs[LIVE, i]
    set_prediction(route, belief.place)
    route.margin = log_ratio(belief.share, belief.rival)
    route.p_steady = belief.p_steady
    if not route.idle:
        choose_technique(state.batch, i)


@inner
def estimate_correctness(state: BeliefState, i: int) -> None:
    """Estimate the correctness p̂ of the prediction: see amusic_gym.estimation.calibration."""
    route, belief, b = state.batch.routes[i], state.beliefs[LIVE, i], state.calibration
    route.log_likelihood = belief.log_likelihood
    if belief.rows > 0:
        mean = belief.log_likelihood / belief.rows
        route.log_likelihood_mean += SMOOTHING * (mean - route.log_likelihood_mean)
    logit = b[0] + b[1] * log_odds(belief.share) + b[2] * route.margin
    logit += b[3] * route.log_likelihood + b[4] * route.log_likelihood_mean
    route.p_correct = sigmoid(logit) * sigmoid(b[5] + b[6] * route.on_map)
    route.logit = logit_of(route.p_correct)
    route.confidence = route.logit


@compiled
def update_routes(address: int) -> None:
    """Estimate the active routes' next frame from the belief that has taken it in."""
    state = state_at(address)
    batch = state.batch
    for i in range(batch.active.size):
        if batch.active[i]:
            route = batch.routes[i]
            frame = route.frame + 1
            for s in range(batch.slots[i].size):
                if batch.slots[i, s].ran:
                    if not prepare(batch.runs[i, s], frame):
                        route.bad_row = 1 + s * route.frames + frame
                    load_result(state, i, s, frame)
            known = route.prediction >= 0 or not route.idle
            if known:
                take_place(state, i)
            relate(batch, i, frame)
            if known:
                estimate_correctness(state, i)
            route.frame = frame
