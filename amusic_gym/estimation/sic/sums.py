"""SIC of one technique, compiled: running sums of z-scores, and the candidates' statistics.

A candidate's statistic sums the z-scores on one diagonal of the score matrix. With one running sum
per diagonal, a frame costs one contiguous add of R numbers and K look-ups, however long the history
is (A-MuSIC, III-A).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import (
    MASKED,
    Run,
    correlation,
    deviation,
    prepare,
    prepared_at,
    row_at,
    top_at,
    z_at,
)
from amusic_gym.estimation.prediction import first_near
from amusic_gym.estimation.sic.state import CARRIED, LIVE, SICState, SumsState
from amusic_gym.kernels.compiling import apart, inner, spliced
from amusic_gym.kernels.tables import part

TILE = 1024
"""Places that several rows are added to in turn, so that their sums stay in the fastest cache."""

SERIAL_MEMORY = 0.98
"""Weight of the mean serial correlation so far against one more row's."""

SERIAL_MOST = 0.999
"""Above it a technique's rows would say nothing at all."""

Floats = NDArray[np.float64]
Places = NDArray[np.int32]


@apart
def add_row(
    sums: Floats, base: int, run: Run, frame: int, age: int, weight: float, decay: float
) -> None:
    """Add the z-scores of a prepared row, times ``weight``, to the sums of their diagonals.

    Args:
        sums: (R + SLACK,).
        base: where the window of the running frame begins.
        run: the technique's rows.
        frame: of the row.
        age: frames since.
        weight: negative for a row that leaves.
        decay: factor on the sums before.
    """
    row, prepared = row_at(run, frame), prepared_at(run, frame)
    mean, scale = prepared.mean, prepared.scale * weight
    window = part(sums, base + age, row.size - age)
    if decay != 1.0:
        for place in range(row.size - age):
            window[place] *= decay
    for place in range(row.size - age):
        window[place] += deviation(row[place], mean) * scale


@apart
def add_waiting(sums: Floats, mark: SumsState, run: Run, frame: int) -> None:
    """Add the rows that wait to the window of ``frame``, or take them out; γ is 1."""
    base = mark.origin - frame
    size, rows = run.references, mark.waiting + mark.leaving
    for start in range(0, size, TILE):
        stop = min(start + TILE, size)
        for k in range(rows):
            came = k < mark.waiting
            past = mark.frames[k] if came else mark.left[k - mark.waiting]
            age = frame - past
            first = max(start, age)
            if first >= stop:
                continue
            prepare(run, past)  # again in an unpickled environment, whose bank starts unprepared
            row, prepared = row_at(run, past), prepared_at(run, past)
            mean, scale = prepared.mean, prepared.scale if came else -prepared.scale
            window = part(sums, base + first, stop - first)
            scores = part(row, first - age, stop - first)
            for place in range(stop - first):
                window[place] += deviation(scores[place], mean) * scale
    mark.waiting, mark.leaving = 0, 0


@apart
def recentre(sums: Floats, mark: SumsState, frame: int, size: int) -> None:
    """Move the window of R sums to the right end, because ``frame`` has left the left one.

    Sums of diagonals that begin after ``mark.last`` are zero: nothing was added to them.
    """
    base = mark.origin - frame
    room = sums.size - size
    kept = size + base  # the window reaches -base places beyond the left end
    for place in range(kept - 1, -1, -1):
        sums[room - base + place] = sums[place]
    for index in range(min(room - base, sums.size)):
        sums[index] = 0.0
    mark.origin = frame + room


@inner
def note_serial(mark: SumsState, run: Run, frame: int) -> None:
    """Add the correlation of a frame's row with the one before, computed once, to its mean."""
    prepared = prepared_at(run, frame)
    if math.isnan(prepared.serial):
        prepare(run, frame - 1)  # as in add_waiting
        prepared.serial = correlation(run, frame - 1, run, frame, 1)
    mark.serial = SERIAL_MEMORY * mark.serial + prepared.serial
    mark.serial_rows = SERIAL_MEMORY * mark.serial_rows + 1.0


@inner
def push(state: SICState, which: int, i: int, s: int, frame: int) -> None:
    """Add the row of ``frame`` to a technique's sums and let rows older than F frames go.

    Args:
        state: SIC's memory.
        which: set of sums, ``LIVE`` or ``LAGGED``.
        i: the route.
        s: the slot; the technique's row of ``frame`` is prepared.
        frame: later than the last one added.
    """
    run, ran = state.batch.runs[i, s], state.batch.ran[i, s]
    sums, mark, gamma = state.sums[which, i, s], state.marks[which, i, s], state.gamma
    if mark.origin < frame:
        recentre(sums, mark, frame, run.references)
    base = mark.origin - frame
    if mark.depth > 0:
        mark.frames[mark.waiting] = frame
        mark.waiting += 1
    else:
        decay = 1.0 if gamma == 1.0 or mark.last < 0 else gamma ** (frame - mark.last)
        add_row(sums, base, run, frame, 0, 1.0, decay)
    while mark.expired < frame - state.history:
        age = frame - mark.expired
        # A row that came and went within one gap was never added, or has left the map; whether
        # there is one is remembered for no longer.
        if age < run.references and ran[mark.expired] and mark.expired <= mark.last:
            if mark.depth == 0:
                prepare(run, mark.expired)  # as in add_waiting
                add_row(sums, base, run, mark.expired, age, -(gamma**age), 1.0)
            else:
                if mark.leaving == mark.depth:
                    add_waiting(sums, mark, run, frame)
                mark.left[mark.leaving] = mark.expired
                mark.leaving += 1
        mark.expired += 1
    if mark.depth > 0 and (mark.waiting == mark.depth or mark.leaving == mark.depth):
        add_waiting(sums, mark, run, frame)
    if frame != mark.last + 1:
        mark.since = frame
    elif mark.discount and frame > 0:
        note_serial(mark, run, frame)
    mark.last = frame


@inner
def discount_of(mark: SumsState) -> float:
    """√((1 − ρ)/(1 + ρ)), ρ the mean serial correlation of a technique's rows; 1 if not kept.

    Stouffer's √n takes rows for independent; of an autoregressive sequence so many of n are.
    """
    discount = 1.0
    if mark.discount:
        rho = min(max(mark.serial / mark.serial_rows, 0.0), SERIAL_MOST)
        discount = math.sqrt((1.0 - rho) / (1.0 + rho))
    return discount


@inner
def count_runs(state: SICState, i: int, s: int, first: int, stop: int) -> None:
    """Extend what weights are made of by the frames from ``first`` to before ``stop``.

    ``counts[p + 1]`` is how many of a technique's frames n ≤ p ran, ``prefix[p + 1]`` the sum of
    ratio^(p−n) over these. Where the ratio is 1, counts are the same, in half the memory.
    """
    ran, counts, prefix = state.batch.ran[i, s], state.counts[i, s], state.prefix[i, s]
    for frame in range(first, stop):
        counts[frame + 1] = counts[frame] + ran[frame]
        if state.ratio != 1.0:
            prefix[frame + 1] = state.ratio * prefix[frame] + ran[frame]


@apart
def with_waiting(total: float, mark: SumsState, run: Run, frame: int, place: int) -> float:
    """The sum of a place at ``frame`` with what the rows that wait will change of it."""
    for k in range(mark.waiting + mark.leaving):
        came = k < mark.waiting
        past = mark.frames[k] if came else mark.left[k - mark.waiting]
        at = place - (frame - past)
        if at >= 0:
            prepare(run, past)  # as in add_waiting
            total += z_at(run, past, at) if came else -z_at(run, past, at)
    return total


@apart
def score_places(
    state: SICState, i: int, s: int, frame: int, places: Places, size: int, out: Floats
) -> float:
    """Write the statistics of places at ``frame`` to ``out``, and return the highest.

    Evidence is Σwz/√Σw², the mean Σwz/Σw. The walk back of a candidate (A-MuSIC, III-A) stops at
    the start of the history, of the run or of the map, whichever is nearest.

    Args:
        state: SIC's memory.
        i: the route.
        s: the slot.
        frame: the last frame on which the technique ran.
        places: (≥ size,) of the map.
        size: how many of them.
        out: (≥ size,).
    """
    run, mark = state.batch.runs[i, s], state.marks[LIVE, i, s]
    window = state.sums[LIVE, i, s][mark.origin - frame :]
    counts, prefix, factors = state.counts[i, s], state.prefix[i, s], state.factors
    evidence, ratio = state.evidence, state.ratio
    reach = min(state.history, frame)
    waits = mark.waiting + mark.leaving > 0
    every = frame - reach >= mark.since  # it ran on all frames that count
    newest = counts[frame + 1]
    best = -math.inf
    for k in range(size):
        place = places[k]
        span = min(reach, place)
        total = window[np.uintp(place)]  # unsigned: no check for a negative index
        if waits:
            total = with_waiting(total, mark, run, frame, place)
        before = np.uintp(frame - span)
        if ratio == 1.0:
            rows = span + 1 if every else newest - counts[before]
            statistic = total * factors[np.uintp(rows)]
        else:
            weight = prefix[frame + 1] - prefix[before] * ratio ** (span + 1)
            statistic = total / math.sqrt(weight) if evidence else total / weight
        out[k] = statistic
        best = max(best, statistic)
    return best


@spliced
def correct_frame(state: SICState, i: int, s: int, frame: int, own: int, fused: int) -> int:
    """Run SIC for one technique on a frame (A-MuSIC, III-A).

    Writes the candidates, the top K of the row and those carried on, to ``state.candidates[s]``
    (K + CARRIED,), and their statistics to ``state.values[s]``: −∞ for what is off the map, or no
    candidate in the row. A row without any candidate is as a constant one.

    Args:
        state: SIC's memory.
        i: the route.
        s: the slot.
        frame: later than the last one on which the technique ran.
        own: the technique's last match, moved on to the frame, −1 where there is none.
        fused: the last prediction, likewise.

    Returns:
        Rank of the candidate of the highest statistic; of equal ones the first.
    """
    run, route = state.batch.runs[i, s], state.batch.routes[i]
    if not prepare(run, frame):
        route.bad_row = 1 + s * route.frames + frame
    push(state, LIVE, i, s, frame)
    top, places, values = top_at(run, frame), state.candidates[s], state.values[s]
    size = top.size + CARRIED
    for k in range(top.size):
        places[k] = top[k]
    places[top.size] = own if state.carry else -1
    places[top.size + 1] = fused if state.carry else -1
    best = score_places(state, i, s, frame, places, top.size, values)
    for k in range(top.size, size):
        values[k] = -math.inf
        if 0 <= places[k] < run.references:
            best = max(best, score_places(state, i, s, frame, places[k:], 1, values[k:]))
    row = row_at(run, frame)
    if prepared_at(run, frame).state == MASKED and row[top[0]] != -math.inf:
        best = -math.inf
        for k in range(size):
            if values[k] != -math.inf and row[places[k]] == -math.inf:
                values[k] = -math.inf
            best = max(best, values[k])
    return first_near(values, best, size)


@apart
def best_rival(state: SICState, i: int, s: int, place: int) -> float:
    """Highest statistic of the candidates beyond the tolerance of ``place``; −∞: there are none.

    In four lanes: comparisons of one chain wait for each other.
    """
    values, places = state.values[s], state.candidates[s]
    tolerance, size = state.batch.routes[i].tolerance, state.batch.runs[i, s].candidates + CARRIED
    a, b, c, d = -math.inf, -math.inf, -math.inf, -math.inf
    for k in range(0, size, 4):
        if abs(places[k] - place) > tolerance:
            a = max(a, values[k])
        if k + 1 < size and abs(places[k + 1] - place) > tolerance:
            b = max(b, values[k + 1])
        if k + 2 < size and abs(places[k + 2] - place) > tolerance:
            c = max(c, values[k + 2])
        if k + 3 < size and abs(places[k + 3] - place) > tolerance:
            d = max(d, values[k + 3])
    return max(max(a, b), max(c, d))


@inner
def store_result(state: SICState, i: int, s: int, frame: int, winner: int) -> None:
    """Store the result of a technique's run in its slot."""
    slot, values = state.batch.slots[i, s], state.values[s]
    slot.last_run = frame
    slot.place = state.candidates[s, winner]
    slot.discount = discount_of(state.marks[LIVE, i, s])
    slot.weight = slot.discount
    slot.statistic = values[winner]
    slot.correction = values[winner] - values[0]
    slot.rival = best_rival(state, i, s, slot.place)
    slot.margin = slot.statistic - slot.rival if slot.rival > -math.inf else 0.0
