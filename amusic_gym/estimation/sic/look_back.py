"""A block of frames again with every technique, compiled: what a selection looks at (III-C1)."""

from __future__ import annotations

import math

from amusic_gym.banks.rows import prepare
from amusic_gym.estimation.sic.state import LAGGED, LIVE, SICState, state_at
from amusic_gym.estimation.sic.sums import (
    correct_frame,
    count_runs,
    discount_of,
    push,
    store_result,
)
from amusic_gym.kernels.compiling import apart, compiled, inner


@apart
def advance_lagged(state: SICState, i: int, s: int, first: int) -> None:
    """Bring the lagged sums of a technique up to the block that starts at ``first``."""
    batch = state.batch
    slot, run, ran = batch.slots[i, s], batch.runs[i, s], batch.ran[i, s]
    for frame in range(slot.lagged, first):
        if ran[frame]:
            prepare(run, frame)  # again in an unpickled environment, whose bank starts unprepared
            push(state, LAGGED, i, s, frame)
    slot.lagged = first


@apart
def restart_from_lagged(state: SICState, i: int, s: int, first: int) -> None:
    """Bring the lagged sums up to the block that starts at ``first`` and restart from them."""
    advance_lagged(state, i, s, first)
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
def match_before(state: SICState, i: int, s: int, first: int) -> int:
    """A technique's last match before frame ``first``, moved on to the frame before it; or −1.

    One from as many frames ago as there are places has left the map, and is not looked for.
    """
    for past in range(first - 1, max(first - 1 - state.batch.routes[i].references, -1), -1):
        if state.batch.ran[i, s, past]:
            place: int = state.places[i, s, past] + (first - 1 - past)
            return place
    return -1


@apart
def run_block(state: SICState, i: int, s: int, first: int, stop: int) -> None:
    """Run a technique on the frames of a block that it missed.

    Writes its statistics and corrections on every frame of the block, as they would have been
    there, to the batch.
    """
    batch = state.batch
    ran = batch.ran[i, s]
    for past in range(first, stop):
        batch.slots[i, s].late_runs += 1 - ran[past]
        ran[past] = True
    count_runs(state, i, s, first, stop)
    restart_from_lagged(state, i, s, first)
    own = match_before(state, i, s, first)
    for past in range(first, stop):
        fused = state.predictions[i, past - 1] if past > 0 else -1
        winner = correct_frame(state, i, s, past, moved_on(own), moved_on(fused))
        own = state.candidates[s, winner]
        state.places[i, s, past] = own
        values = state.values[s]
        batch.statistics[i, past - first, s] = values[winner] * discount_of(state.marks[LIVE, i, s])
        batch.corrections[i, s, past - first] = values[winner] - values[0]
        if past == stop - 1:
            store_result(state, i, s, past, winner)


@compiled
def look_back(address: int) -> None:
    """Run all techniques on the last block of the routes that want it, after the fact.

    The sums up to the block are kept apart, and brought up to it first. A bank's wait for a
    selection; those of live techniques, whose rows will not be there for long, are always brought
    up. The sums are the same: no later selection changes what ran before the block.

    Args:
        address: of the words of a :class:`~amusic_gym.estimation.sic.state.SICState`.
    """
    state = state_at(address)
    batch = state.batch
    for i in range(batch.active.size):
        stop = batch.routes[i].frame + 1
        first = max(0, stop - batch.block)
        for s in range(batch.slots[i].size):
            if not batch.slots[i, s].present:
                for past in range(stop - first):
                    batch.statistics[i, past, s] = -math.inf
            elif batch.wanted[i]:
                run_block(state, i, s, first, stop)
            elif batch.lagging[i] and batch.runs[i, s].entries != 0:
                advance_lagged(state, i, s, first)
