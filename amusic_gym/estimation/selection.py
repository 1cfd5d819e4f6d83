"""The selection of A-MuSIC (III-C1), compiled: look back at a block of frames, choose techniques.

A selection changes the past: every technique is run on the frames of the block that it missed.
"""

from __future__ import annotations

import math
from typing import Any

from amusic_gym.banks.rows import prepare, top_at
from amusic_gym.estimation.dynamics import correct_frame, load_result, store_result
from amusic_gym.estimation.records import LAGGED, LIVE, Outcome, Rules, State, batch_at
from amusic_gym.estimation.sic import candidate_at, discount_of, first_best, push, ratio_of, weigh
from amusic_gym.kernels.compiling import apart, compiled, inner


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
            prepare(run, frame)  # again in an unpickled environment, whose bank starts unprepared
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
    live.serial, live.serial_rows = mark.serial, mark.serial_rows
    live.waiting = mark.waiting
    live.leaving = mark.leaving
    for k in range(mark.waiting):
        live.frames[k] = mark.frames[k]
    for k in range(mark.leaving):
        live.left[k] = mark.left[k]


@inner
def moved_on(place: int) -> int:
    """A place one frame later, −1 for none."""
    return place + 1 if place >= 0 else -1


@apart
def match_before(state: State, i: int, s: int, first: int) -> int:
    """A technique's last match before frame ``first``, moved on to the frame before it; or −1."""
    for past in range(first - 1, -1, -1):
        if state.ran[i, s, past]:
            place: int = state.places[i, s, past] + (first - 1 - past)
            return place
    return -1


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
    ratio = ratio_of(rules.gamma, rules.evidence)
    weigh(state.counts[i, s], state.prefix[i, s], ran, first, frame, ratio)
    rebuild_lagged(state, rules, i, s, first)
    own = match_before(state, i, s, first)
    for past in range(first, frame):
        fused = state.predictions[i, past - 1] if past > 0 else -1
        winner = correct_frame(state, rules, i, s, past, moved_on(own), moved_on(fused), out)
        own = candidate_at(top_at(state.runs[i, s], past), state.carried[s], winner)
        state.places[i, s, past] = own
        values = state.values[s]
        discount = discount_of(state.marks[LIVE, i, s])
        statistics[past - first, s] = values[winner] * discount
        out.corrections[i, s, past - first] = values[winner] - values[0]
        if past == frame - 1:
            store_result(state, state.routes[i].tolerance, i, s, past, winner)


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
            load_result(state, i, s, frame - 1)


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


@compiled
def select_routes(address: int) -> None:
    """Do a selection on every active route whose action asks for one, before the plan.

    Args:
        address: of a table of the layout ``BATCH``; with the statistic ``belief``, what looking
            back came to is in it (:func:`amusic_gym.estimation.belief.look_back`).
    """
    batch = batch_at(address)
    state, rules, out = batch.state, batch.rules, batch.out
    for i in range(batch.active.size):
        frame = state.routes[i].frame + 1
        if batch.active[i]:
            if not rules.belief:
                keep_up(state, rules, i, frame)
            if batch.actions[i, -1] and frame > 0:
                select(state, rules, i, frame, out)
