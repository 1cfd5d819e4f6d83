"""One frame of a batch of routes, compiled: run techniques, correct (SIC), fuse (MuSIC), observe.

This is the only implementation of the environment's dynamics. :class:`amusic_gym.episode.Episodes`
owns the arrays and calls :func:`step_routes`; the single and the vector environment own an
``Episodes``. Every array has the batch of N routes as its leading axis and S technique slots next.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym._compile import apart, compiled, inner
from amusic_gym.belief.places import log_odds, log_ratio
from amusic_gym.observation import SMOOTHING, observe
from amusic_gym.rows import mean_at, prepare, row_at, scale_at, top_at
from amusic_gym.sic import (
    best_rival,
    first_best,
    push,
    ratio_of,
    score_candidates,
    statistic_of,
    weigh,
    weight_of,
)

IDLE_DECAY = 0.9
"""Factor on p̂ and confidence per frame on which nothing ran."""

DOUBT = 0.5
"""A frame with p̂ below this is one of doubt."""

LIVE, LAGGED = 0, 1
"""Two sets of running sums: up to the last frame, and up to the block that may be re-selected."""

ROUTE = np.dtype(
    [
        ("frame", np.int64),  # last frame processed, -1 after a reset
        ("frames", np.int64),  # length of the episode's route
        ("references", np.int64),
        ("tolerance", np.int64),
        ("total_seconds", np.float64),  # Σ seconds of the techniques present
        ("compute_weight", np.float64),  # λ
        ("weight_log", np.float64),  # λ as the observation has it
        ("prediction", np.int64),  # -1 until there is one
        ("confidence", np.float64),
        ("margin", np.float64),
        ("p_correct", np.float64),
        ("p_correct_mean", np.float64),
        ("continues", np.float64),  # 1 if the prediction moved on by one place
        ("since_doubt", np.float64),
        ("spent", np.float64),  # seconds to charge for this step; -1: those declared of its runs
        ("compute", np.float64),  # seconds of this step / total_seconds
        ("compute_mean", np.float64),
        ("agreeing", np.float64),  # share of techniques whose diagonal is the fused one
        ("steady", np.float64),  # belief in steady motion
        ("said", np.float64),  # belief: log-likelihood that the frame's rows gave the prediction
        ("said_mean", np.float64),  # running mean of its mean over the rows
        ("strange", np.float64),  # how much more than usual the rows changed, as a ratio
        ("size_log", np.float64),  # length of the map as the observation has it
    ]
)

SLOT = np.dtype(
    [
        ("present", np.uint8),
        ("seconds", np.float64),  # declared cost of one run
        ("cost_share", np.float64),  # costs as the observation has them
        ("cost_log", np.float64),
        ("price", np.float64),
        ("ran", np.uint8),  # on this frame
        ("chosen", np.uint8),  # trusted by MuSIC on this frame
        ("last_run", np.int64),  # -1 before the first
        ("place", np.int64),  # corrected match of the last run
        ("statistic", np.float64),
        ("rival", np.float64),  # statistic of the technique's own best rival, -inf: none
        ("margin", np.float64),  # over that rival
        ("correction", np.float64),
        ("agrees", np.float64),  # 1 if place, moved along its diagonal, is the fused one
        ("agreement", np.float64),  # running mean of agrees over the runs
        ("support", np.float64),  # z-score of the fused place in the last row
        ("support_mean", np.float64),
        ("stored", np.float64),  # what the last run said for the fused diagonal
        ("trust", np.float64),  # belief: probability that a row is informative
        ("sharpness", np.float64),  # belief: how sharp they are on average, of at most 1
        ("weight", np.float64),  # belief: of the last row, less where it repeats the one before
        ("lagged", np.int64),  # frames before this one are in the lagged sums
    ]
)


class Rules(NamedTuple):
    """Numbers that hold for every route of a batch."""

    history: int
    gamma: float
    evidence: bool
    belief: bool
    block: int  # M; 0: no re-select bit
    coverage: float  # E
    allow_idle: bool
    calibration: NDArray[np.float64]  # (C,), see amusic_gym.calibration


class State(NamedTuple):
    """What a batch of routes remembers."""

    routes: NDArray[Any]  # (N,) ROUTE
    slots: NDArray[Any]  # (N, S) SLOT
    runs: NDArray[Any]  # (N, S) RUN
    marks: NDArray[Any]  # (2, N, S) SUMS
    sums: NDArray[np.float64]  # (2, N, S, R + SLACK); one set only without re-selection
    ran: NDArray[np.uint8]  # (N, S, Q)
    prefix: NDArray[np.float64]  # (N, S, Q + 1) prefix weights
    values: NDArray[np.float64]  # (S, K) scratch: statistics of the candidates
    scratch: NDArray[np.float64]  # (K or S,) more scratch, whichever is longer
    minds: NDArray[Any]  # (N,) MIND: what the belief came to; not used without
    witnesses: NDArray[Any]  # (N, S) WITNESS: what each technique made of it
    late: NDArray[np.int64]  # (N, S) runs that looking back at the last block took
    statistics: NDArray[np.float64]  # (N, M, S) statistics on its frames
    corrections: NDArray[np.float64]  # (N, S, M)


RESULT = np.dtype(
    [
        ("frame", np.int64),
        ("prediction", np.int64),
        ("confidence", np.float64),
        ("margin", np.float64),  # 0 without a rival
        ("p_correct", np.float64),
        ("technique", np.int64),  # trusted by MuSIC, -1: none
        ("seconds", np.float64),  # cost of this step, after-the-fact runs included
        ("compute", np.float64),  # seconds / Σ seconds
        ("fallback", np.bool_),  # the action was empty and the cheapest technique ran
        ("idle", np.bool_),  # nothing ran
        ("happened", np.bool_),  # a selection was done in this step
        ("bad_row", np.int64),  # 0, or 1 + slot · frames + frame of a row that is not finite
    ]
)

SLOT_RESULT = np.dtype(
    [
        ("ran", np.bool_),
        ("place", np.int64),  # corrected match
        ("statistic", np.float64),
        ("correction", np.float64),
        ("selected", np.bool_),  # in the set that a selection of this step chose
        ("tally", np.int64),  # frames of the block on which MuSIC chose the technique
        ("late_runs", np.int64),  # after-the-fact runs of this step
    ]
)


class Outcome(NamedTuple):
    """What one step gives; fresh arrays every time."""

    routes: NDArray[Any]  # (N,) RESULT
    slots: NDArray[Any]  # (N, S) SLOT_RESULT
    corrections: NDArray[np.float64]  # (N, S, M) over the block of a selection
    observation: NDArray[np.float32]  # (N, D)


@inner
def correct_frame(state: State, rules: Rules, i: int, s: int, frame: int, out: Outcome) -> int:
    """Run SIC for one technique on a frame; statistics to ``state.values[s]``; winner's rank."""
    run = state.runs[i, s]
    if not prepare(run, frame):
        out.routes[i].bad_row = 1 + s * state.routes[i].frames + frame
    sums, mark = state.sums[LIVE, i, s], state.marks[LIVE, i, s]
    push(sums, mark, run, state.ran[i, s], frame, rules.history, rules.gamma)
    prefix = state.prefix[i, s]
    values = state.values[s]
    top = top_at(run, frame)
    history, gamma, evidence = rules.history, rules.gamma, rules.evidence
    score_candidates(
        sums, mark, top, prefix, frame, history, gamma, evidence, state.scratch, values
    )
    return first_best(values, top.size)


@inner
def remember(state: State, tolerance: int, i: int, s: int, frame: int, winner: int) -> None:
    """Store the outcome of a technique's run in its slot."""
    slot, values = state.slots[i, s], state.values[s]
    top = top_at(state.runs[i, s], frame)
    slot.last_run = frame
    slot.place = top[winner]
    slot.statistic = values[winner]
    slot.correction = values[winner] - values[0]
    rival = best_rival(values, top, top.size, slot.place, tolerance, -math.inf)
    slot.rival = rival
    slot.margin = slot.statistic - rival if rival > -math.inf else 0.0


@inner
def recall(state: State, i: int, s: int, frame: int) -> None:
    """Store in its slot what a technique's run made of the belief."""
    slot, known = state.slots[i, s], state.witnesses[i, s]
    slot.last_run = frame
    slot.place = known.place
    slot.statistic = known.statistic
    slot.correction = known.correction
    slot.margin = known.margin
    slot.trust = known.trust
    slot.sharpness = 0.25 * known.once + 0.5 * known.twice + known.fourfold
    slot.weight = known.weight
    slot.stored = known.said


@apart
def select_techniques(slots: Any, frames: int, coverage: float) -> None:
    """Take techniques by falling tally until it covers the block (A-MuSIC, III-C1)."""
    target = math.ceil(coverage * frames - 1e-9)
    covered = 0
    while covered < target:
        best = -1
        for s in range(slots.size):
            if not slots[s].selected and (best < 0 or slots[s].tally > slots[best].tally):
                best = s
        slots[best].selected = True
        covered += slots[best].tally


@apart
def advance_lagged(state: State, rules: Rules, i: int, s: int, first: int) -> None:
    """Bring the lagged sums of a technique up to the block that starts at ``first``."""
    slot, run, ran = state.slots[i, s], state.runs[i, s], state.ran[i, s]
    sums, mark = state.sums[LAGGED, i, s], state.marks[LAGGED, i, s]
    for frame in range(slot.lagged, first):
        if ran[frame]:
            push(sums, mark, run, ran, frame, rules.history, rules.gamma)
    slot.lagged = first


@apart
def keep_up(state: State, rules: Rules, i: int, frame: int) -> None:
    """Advance the lagged sums of live techniques, whose rows will not be there for long.

    A bank's wait for a selection. The sums are the same: no later selection changes what ran
    before the block of M frames that ends here.
    """
    for s in range(state.slots[i].size):
        if state.slots[i, s].present and state.runs[i, s].entries != 0:
            advance_lagged(state, rules, i, s, max(0, frame - rules.block))


@apart
def rebuild_lagged(state: State, rules: Rules, i: int, s: int, first: int) -> None:
    """Bring the lagged sums up to the block that starts at ``first`` and restart from them."""
    advance_lagged(state, rules, i, s, first)
    sums, mark = state.sums[LAGGED, i, s], state.marks[LAGGED, i, s]
    fresh = state.sums[LIVE, i, s]
    for place in range(sums.size):  # a loop: assigning a slice compiles ten times as long
        fresh[place] = sums[place]
    live = state.marks[LIVE, i, s]
    live.origin, live.last = mark.origin, mark.last
    live.expired, live.since = mark.expired, mark.since


@apart
def run_block(
    state: State, rules: Rules, i: int, s: int, frame: int, statistics: Any, out: Outcome
) -> None:
    """Run a technique on the frames of the block before ``frame`` that it missed.

    Writes its statistic on every frame of the block, as it would have been there, to column s of
    ``statistics`` (M, S).
    """
    first = max(0, frame - rules.block)
    ran = state.ran[i, s]
    for past in range(first, frame):
        out.slots[i, s].late_runs += 1 - ran[past]
        ran[past] = 1
    weigh(state.prefix[i, s], ran, first, frame, ratio_of(rules.gamma, rules.evidence))
    rebuild_lagged(state, rules, i, s, first)
    for past in range(first, frame):
        winner = correct_frame(state, rules, i, s, past, out)
        values = state.values[s]
        statistics[past - first, s] = values[winner]
        out.corrections[i, s, past - first] = values[winner] - values[0]
        if past == frame - 1:
            remember(state, state.routes[i].tolerance, i, s, past, winner)


@apart
def recall_block(state: State, rules: Rules, i: int, frame: int, out: Outcome) -> None:
    """Take over what looking back at the block before ``frame`` came to (belief.look_back)."""
    size = min(rules.block, frame)
    for s in range(state.slots[i].size):
        if state.slots[i, s].present:
            out.slots[i, s].late_runs = state.late[i, s]
            for past in range(frame - size, frame):
                if not prepare(state.runs[i, s], past):
                    out.routes[i].bad_row = 1 + s * state.routes[i].frames + past
            for past in range(size):
                out.corrections[i, s, past] = state.corrections[i, s, past]
            recall(state, i, s, frame - 1)


@apart
def select(state: State, rules: Rules, i: int, frame: int, out: Outcome) -> None:
    """Do the selection of A-MuSIC (III-C1) over the block of frames before ``frame``."""
    slots = state.slots[i]
    size = min(rules.block, frame)
    statistics = state.statistics[i]
    if rules.belief:
        recall_block(state, rules, i, frame, out)
    else:
        for s in range(slots.size):
            for past in range(size):
                statistics[past, s] = -math.inf
            if slots[s].present:
                run_block(state, rules, i, s, frame, statistics, out)
    for s in range(slots.size):
        out.routes[i].seconds += out.slots[i, s].late_runs * slots[s].seconds
    for past in range(size):
        out.slots[i, first_best(statistics[past], slots.size)].tally += 1
    select_techniques(out.slots[i], size, rules.coverage)
    out.routes[i].happened = True


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
    """Write down what runs on the next frame, and what it costs."""
    frame = state.routes[i].frame + 1
    ratio = ratio_of(rules.gamma, rules.evidence)
    for s in range(state.slots[i].size):
        slot = state.slots[i, s]
        slot.ran, slot.chosen = out.slots[i, s].ran, False
        if slot.present:
            state.ran[i, s, frame] = slot.ran
            weigh(state.prefix[i, s], state.ran[i, s], frame, frame + 1, ratio)
            if slot.ran:
                out.routes[i].seconds += slot.seconds


@inner
def run_techniques(state: State, rules: Rules, i: int, frame: int, out: Outcome) -> None:
    """Run the chosen techniques on the frame and correct each."""
    for s in range(state.slots[i].size):
        slot = state.slots[i, s]
        if not slot.ran:
            continue
        if rules.belief:
            if not prepare(state.runs[i, s], frame):
                out.routes[i].bad_row = 1 + s * state.routes[i].frames + frame
            recall(state, i, s, frame)
        else:
            winner = correct_frame(state, rules, i, s, frame, out)
            remember(state, state.routes[i].tolerance, i, s, frame, winner)
        out.slots[i, s].place = slot.place
        out.slots[i, s].statistic = slot.statistic
        out.slots[i, s].correction = slot.correction


@inner
def sigmoid(logit: float) -> float:
    """1 / (1 + exp(−logit))."""
    return 1.0 / (1.0 + math.exp(-min(max(logit, -30.0), 30.0)))


@inner
def estimate(calibration: Any, statistic: float, margin: float, has_rival: bool) -> float:
    """p̂ of a match: see amusic_gym.calibration."""
    s = math.asinh(statistic)
    if has_rival:
        logit = calibration[0] + calibration[1] * s + calibration[2] * math.asinh(margin)
    else:
        logit = calibration[3] + calibration[4] * s
    return sigmoid(logit)


@inner
def trust_highest(state: State, i: int, out: Outcome) -> int:
    """Choose the technique of the highest statistic (MuSIC, III-B)."""
    slots, statistics = state.slots[i], state.scratch
    for s in range(slots.size):
        statistics[s] = slots[s].statistic if slots[s].ran else -math.inf
    chosen = first_best(statistics, slots.size)
    slots[chosen].chosen = True
    out.routes[i].technique = chosen
    return chosen


@inner
def arrive(route: Any, place: int) -> None:
    """Make ``place`` the prediction."""
    route.continues = 1.0 if route.prediction >= 0 and place == route.prediction + 1 else 0.0
    route.prediction = place


@inner
def fuse(state: State, rules: Rules, i: int, frame: int, out: Outcome) -> None:
    """Trust the technique of the highest statistic (MuSIC, III-B) and estimate correctness."""
    slots, route = state.slots[i], state.routes[i]
    chosen = trust_highest(state, i, out)
    place = slots[chosen].place
    rival = -math.inf
    for s in range(slots.size):
        if not slots[s].ran:
            continue
        if s == chosen:
            rival = max(rival, slots[s].rival)
        else:
            top = top_at(state.runs[i, s], frame)
            rival = best_rival(state.values[s], top, top.size, place, route.tolerance, rival)
    has_rival = rival > -math.inf
    arrive(route, place)
    route.confidence = slots[chosen].statistic
    route.margin = route.confidence - rival if has_rival else 0.0
    route.p_correct = estimate(rules.calibration, route.confidence, route.margin, has_rival)


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
    arrive(route, mind.place)
    route.margin = log_ratio(mind.share, mind.rival)
    route.said = mind.said
    if mind.heard > 0:
        route.said_mean += SMOOTHING * (mind.said / mind.heard - route.said_mean)
    logit = b[0] + b[1] * log_odds(mind.share) + b[2] * route.margin
    logit += b[3] * route.said + b[4] * route.said_mean
    route.confidence = min(max(logit, -30.0), 30.0)
    route.p_correct = sigmoid(logit)
    route.steady, route.strange = mind.steady, mind.strange
    if not out.routes[i].idle:
        trust_highest(state, i, out)


@inner
def coast(route: Any) -> None:
    """Move the prediction on by one place when nothing ran."""
    moves = 0 <= route.prediction < route.references - 1
    route.continues = 1.0 if moves else 0.0
    route.prediction += moves
    route.margin = 0.0
    route.confidence *= IDLE_DECAY
    route.p_correct *= IDLE_DECAY


@inner
def stored_statistic(state: State, rules: Rules, i: int, s: int, place: int) -> float:
    """Statistic that a place of the technique's last run had."""
    if place < 0:
        return 0.0
    mark, frame = state.marks[LIVE, i, s], state.slots[i, s].last_run
    prefix = state.prefix[i, s]
    total = state.sums[LIVE, i, s, mark.origin - frame + place]
    ratio = ratio_of(rules.gamma, rules.evidence)
    weight = weight_of(prefix, frame, place, rules.history, ratio)
    return statistic_of(total, weight, rules.evidence)


@inner
def relate(state: State, rules: Rules, i: int, frame: int) -> None:
    """Relate every technique's last run to the fused prediction (features of the observation)."""
    slots, route = state.slots[i], state.routes[i]
    present, agreeing = 0, 0.0
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
            z = row_at(run, frame)[route.prediction] - mean_at(run, frame)[0]
            slot.support = z * scale_at(run, frame)[0]
            slot.support_mean += SMOOTHING * (slot.support - slot.support_mean)
            slot.agreement += SMOOTHING * (slot.agrees - slot.agreement)
    route.agreeing = agreeing / present


@inner
def report(state: State, i: int, frame: int, out: Outcome) -> None:
    """Finish the route's memory of the frame and copy it to the outcome."""
    route = state.routes[i]
    route.frame = frame
    route.since_doubt = 0.0 if route.p_correct < DOUBT else route.since_doubt + 1.0
    route.p_correct_mean += SMOOTHING * (route.p_correct - route.p_correct_mean)
    if route.spent >= 0.0:
        out.routes[i].seconds = route.spent
    route.compute = out.routes[i].seconds / route.total_seconds
    route.compute_mean += SMOOTHING * (route.compute - route.compute_mean)
    show(state, i, out)


@inner
def show(state: State, i: int, out: Outcome) -> None:
    """Copy what is known of a route to the outcome."""
    route = state.routes[i]
    out.routes[i].frame = route.frame
    out.routes[i].prediction = route.prediction
    out.routes[i].confidence = route.confidence
    out.routes[i].margin = route.margin
    out.routes[i].p_correct = route.p_correct
    out.routes[i].compute = route.compute
    observe(route, state.slots[i], out.observation[i])


@inner
def plan_route(state: State, rules: Rules, i: int, action: Any, out: Outcome) -> None:
    """Decide what runs on the next frame of route ``i``, with a selection where it is asked for."""
    frame = state.routes[i].frame + 1
    if rules.block > 0:
        if not rules.belief:
            keep_up(state, rules, i, frame)
        if action[-1] and frame > 0:
            select(state, rules, i, frame, out)
    choose_runs(state, rules, i, action, out)
    note_runs(state, rules, i, out)


@inner
def process_route(state: State, rules: Rules, i: int, out: Outcome) -> None:
    """Process the next frame of route ``i``; the rows of what runs on it are there."""
    frame = state.routes[i].frame + 1
    run_techniques(state, rules, i, frame, out)
    if out.routes[i].idle:
        out.routes[i].technique = -1
    if rules.belief:
        believe(state, rules, i, out)
    elif out.routes[i].idle:
        coast(state.routes[i])
    else:
        fuse(state, rules, i, frame, out)
    relate(state, rules, i, frame)
    report(state, i, frame, out)


@compiled
def step_routes(
    state: State, rules: Rules, active: Any, actions: Any, plan: bool, process: bool, out: Outcome
) -> None:
    """Process the next frame of every active route and show the others as they are.

    A live route computes the rows that a plan names before they are processed, and those of a
    selection's block before the plan; and the belief (:mod:`amusic_gym.belief`) looks back before
    the plan and hears the rows before they are processed. Else both are done at once.

    Args:
        state: the batch's memory, changed in place.
        rules: numbers that hold for all.
        active: (N,) bool.
        actions: (N, A) bool; A = S, or S + 1 with the re-select bit last.
        plan: decide what runs.
        process: run what was decided, in this call or, with the same ``out``, the last.
        out: outcome to fill, zeroed.
    """
    for i in range(active.size):
        if active[i]:
            if plan:
                plan_route(state, rules, i, actions[i], out)
            if process:
                process_route(state, rules, i, out)
        elif process:
            out.routes[i].technique = -1
            show(state, i, out)
