"""The Bayes filter over places, frame by frame."""

from __future__ import annotations

import math
from typing import Any

from amusic_gym.banks.rows import prepare, top_at
from amusic_gym.estimation.belief.memory import REACH, Minds, copy_mind, minds_at
from amusic_gym.estimation.belief.motion import move
from amusic_gym.estimation.belief.places import (
    conclude,
    log_odds,
    log_ratio,
    looks_of,
    places_of,
    rescale,
    testify,
    weigh_places,
)
from amusic_gym.estimation.belief.rates import LOCKED, WAYS
from amusic_gym.estimation.belief.rows import RECENT, listen, total
from amusic_gym.estimation.belief.trust import learn, likelihood, voice
from amusic_gym.estimation.prediction import (
    SMOOTHING,
    choose_technique,
    relate,
    remember,
    set_prediction,
    sigmoid,
)
from amusic_gym.kernels.compiling import apart, compiled, inner, spliced, without_gil
from amusic_gym.kernels.tables import part

SAME = 1e-4
"""Two rows whose correlation falls short of 1 by less than this are the same."""

MANY = 32
"""Techniques whose likelihoods, from DOUBT to R, can be multiplied within the range of a float."""


@apart
def hear_rows(minds: Minds, which: int, i: int, frame: int, runs: Any, ran: Any) -> bool:
    """Standardise the rows of a frame; whether one is the same as that of the frame before.

    Notes in the MIND record how much more than usual the rows have changed since.
    """
    mind = minds.minds[which, i]
    same, strange, compared = False, 0.0, 0
    for s in range(ran.shape[0]):
        if not ran[s, frame]:
            continue
        known = minds.witnesses[which, i, s]
        novelty = listen(minds.rates, known, runs[s], frame, minds.hubs[which, i, s], minds.rows[s])
        if novelty >= 0.0 and known.last == frame - 1:
            if novelty < SAME:
                same = True
            elif known.novelty > 0.0:
                strange += novelty / known.novelty
                compared += 1
        if novelty >= SAME:
            usual = known.novelty if known.novelty > 0.0 else novelty
            known.novelty = usual + RECENT * (min(novelty, 3.0 * usual) - usual)
        known.last = frame
        known.count += 1.0
    mind.strange = strange / compared if compared > 0 else 0.0
    return same


@spliced
def weigh_rows(
    minds: Minds, which: int, i: int, frame: int, runs: Any, ran: Any, size: int, tolerance: int
) -> None:
    """Turn the rows into likelihoods, and their product over the belief so far into the new one."""
    mind, prior = minds.minds[which, i], minds.prior
    now = minds.belief[which, i, mind.side]
    looks_of(now, size, prior)
    for s in range(ran.shape[0]):
        if ran[s, frame]:
            known, row, words = minds.witnesses[which, i, s], minds.rows[s], minds.voices[s]
            voice(minds.rates, known, size, row, words)
            top, joint, windows = top_at(runs[s], frame)[0], minds.joint, minds.windows
            testify(known, prior, row, words, top, size, tolerance, joint, windows)
    for place in range(size):
        prior[place] = 1.0
    for s in range(ran.shape[0]):
        if ran[s, frame]:
            row, words = minds.rows[s], minds.voices[s]
            for place in range(size):
                prior[place] *= likelihood(words, row[place])
        if s % MANY == MANY - 1:
            rescale(prior, size)
    weigh_places(now, prior, size)


@spliced
def look_over(minds: Minds, which: int, i: int, frame: int, ran: Any, size: int) -> None:
    """Note what the rows said of the place in the end, and learn whom to trust."""
    mind, looks = minds.minds[which, i], minds.prior
    looks_of(minds.belief[which, i, mind.side], size, looks)
    mind.said, mind.heard = 0.0, 0
    for s in range(ran.shape[0]):
        if ran[s, frame]:
            known, row, words = minds.witnesses[which, i, s], minds.rows[s], minds.voices[s]
            known.said = math.log(likelihood(words, row[mind.place]))
            mind.said += known.said
            mind.heard += 1
            learn(minds.rates, known, size, row, words, looks, minds.windows)


@apart
def normalise(mind: Any, now: Any, whole: float, size: int) -> None:
    """Make the belief sum to 1, and note how much of it is in steady motion."""
    mind.steady = 0.0
    for way in range(WAYS):
        line = part(now[way], REACH, size)
        for place in range(size):
            line[place] /= whole
        if way >= LOCKED:
            mind.steady += total(line, size)


@inner
def places_in(runs: Any) -> int:
    """R: places of the map; slots without a technique have none."""
    size = 0
    for s in range(runs.size):
        size = max(size, runs[s].references)
    return size


@spliced
def filter_frame(
    minds: Minds, which: int, i: int, frame: int, runs: Any, ran: Any, tolerance: int
) -> None:
    """Take one frame into the belief of route ``i``: what ran on it, and that it passed.

    Leaves each technique's own word in its WITNESS record, what all say in the MIND record, and
    the belief over places in ``minds.joint``.

    Args:
        minds: the batch's memory.
        which: set of it, live or lagged.
        i: the route.
        frame: frame index, one more than the last.
        runs: (S,) RUN records; the rows of what ran are prepared.
        ran: (S, Q) uint8.
        tolerance: places off that still count as true.
    """
    rates, mind, belief = minds.rates, minds.minds[which, i], minds.belief[which, i]
    size = places_in(runs)
    same = hear_rows(minds, which, i, frame, runs, ran)
    if frame > 0:
        rise = rates.jump_novel * (mind.strange - rates.jump_usual) if mind.strange > 0.0 else 0.0
        jump = math.exp(min(max(rise, -3.0), 3.0))
        stand = rates.stand if same else 1.0
        move(rates, mind, belief, size, stand, jump, minds.joint, minds.windows)
    mind.frame = frame
    weigh_rows(minds, which, i, frame, runs, ran, size, tolerance)
    now = belief[mind.side]
    places_of(now, size, minds.joint)
    whole = total(minds.joint, size)
    normalise(mind, now, whole, size)
    conclude(minds, mind, size, tolerance, whole)
    look_over(minds, which, i, frame, ran, size)


@spliced
def prepare_frame(minds: Minds, which: int, i: int, frame: int, runs: Any, ran: Any) -> None:
    """Prepare the rows that taking in a frame of route ``i`` needs."""
    for s in range(ran.shape[0]):
        if ran[s, frame]:
            last = minds.witnesses[which, i, s].last
            if last >= 0:
                prepare(runs[s], last)  # an unpickled bank has forgotten what it knew of its rows
            prepare(runs[s], frame)


@spliced
def hear(minds: Minds, which: int, i: int, frame: int, runs: Any, ran: Any, tolerance: int) -> None:
    """Prepare the rows of a frame and take them into the belief of route ``i``."""
    prepare_frame(minds, which, i, frame, runs, ran)
    filter_frame(minds, which, i, frame, runs, ran, tolerance)


@without_gil
def hear_routes(address: int) -> None:
    """Take the next frame of every active route into its belief.

    Args:
        address: of the words of a :class:`~amusic_gym.estimation.belief.memory.Minds`.
    """
    minds = minds_at(address)
    batch = minds.batch
    for i in range(batch.active.size):
        if batch.active[i]:
            route = batch.routes[i]
            hear(minds, 0, i, route.frame + 1, batch.runs[i], batch.ran[i], route.tolerance)


@compiled
def prepare_rows(address: int) -> None:
    """Prepare the rows that :func:`hear_routes` will need: several routes may share them.

    Args:
        address: of the words of a :class:`~amusic_gym.estimation.belief.memory.Minds`.
    """
    minds = minds_at(address)
    batch = minds.batch
    for i in range(batch.active.size):
        if batch.active[i]:
            prepare_frame(minds, 0, i, batch.routes[i].frame + 1, batch.runs[i], batch.ran[i])


@spliced
def hear_again(minds: Minds, i: int, first: int, stop: int) -> None:
    """Go through the frames from ``first`` to before ``stop`` with every row of route ``i``."""
    batch = minds.batch
    ran, slots = batch.ran[i], batch.slots[i]
    for s in range(slots.size):
        for frame in range(first, stop):
            if slots[s].present and not ran[s, frame]:
                slots[s].late_runs += 1
                ran[s, frame] = True
    copy_mind(minds, 1, 0, i)
    for frame in range(first, stop):
        hear(minds, 0, i, frame, batch.runs[i], ran, batch.routes[i].tolerance)
        for s in range(slots.size):
            known = minds.witnesses[0, i, s]
            statistic = known.statistic if slots[s].present else -math.inf
            batch.statistics[i, frame - first, s] = statistic
            batch.corrections[i, s, frame - first] = known.correction
    for s in range(slots.size):
        if slots[s].present:
            for frame in range(first, stop):
                if not prepare(batch.runs[i, s], frame):
                    batch.routes[i].bad_row = 1 + s * batch.routes[i].frames + frame
            load_result(minds, i, s, stop - 1)


@compiled
def look_back(address: int) -> None:
    """Run all techniques on the last frames of the routes that want it, after the fact.

    The belief before that block is kept apart, and so is brought up to it first; then the block is
    gone through again with every row.

    Args:
        address: of the words of a :class:`~amusic_gym.estimation.belief.memory.Minds`, two sets.
    """
    minds = minds_at(address)
    batch = minds.batch
    for i in range(batch.wanted.size):
        route = batch.routes[i]
        stop = route.frame + 1
        first = max(0, stop - batch.block)
        if batch.wanted[i] or batch.lagging[i]:
            for frame in range(minds.minds[1, i].frame + 1, first):
                hear(minds, 1, i, frame, batch.runs[i], batch.ran[i], route.tolerance)
        if batch.wanted[i]:
            hear_again(minds, i, first, stop)


@inner
def load_result(minds: Minds, i: int, s: int, frame: int) -> None:
    """Store a technique's result in its slot."""
    slot, known = minds.batch.slots[i, s], minds.witnesses[0, i, s]
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


@spliced
def load_results(minds: Minds, i: int, frame: int) -> None:
    """Store the results of the techniques that run on the frame."""
    batch = minds.batch
    for s in range(batch.slots[i].size):
        if batch.slots[i, s].ran:
            if not prepare(batch.runs[i, s], frame):
                batch.routes[i].bad_row = 1 + s * batch.routes[i].frames + frame
            load_result(minds, i, s, frame)


@inner
def believe(minds: Minds, i: int) -> None:
    """Take the place whose surroundings hold most of the belief; estimate correctness.

    The technique trusted is the one of the highest statistic, as in MuSIC; the place is what all
    that ran say together.
    """
    batch = minds.batch
    route, mind, b = batch.routes[i], minds.minds[0, i], minds.calibration
    if route.prediction < 0 and route.idle:
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
    if not route.idle:
        choose_technique(batch, i)


@compiled
def update_routes(address: int) -> None:
    """Estimate the active routes' next frame from the belief that has taken it in.

    Args:
        address: of the words of a :class:`~amusic_gym.estimation.belief.memory.Minds`.
    """
    minds = minds_at(address)
    batch = minds.batch
    for i in range(batch.active.size):
        if batch.active[i]:
            route = batch.routes[i]
            frame = route.frame + 1
            load_results(minds, i, frame)
            believe(minds, i)
            relate(batch, i, frame)
            remember(route)
            route.frame = frame
