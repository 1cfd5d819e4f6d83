"""Running sums of z-scores along the diagonals of the score matrix, compiled.

A candidate's statistic sums the z-scores on one diagonal. With one running sum per diagonal, a
frame costs one contiguous add of R numbers and K look-ups, however long the history is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import (
    Run,
    deviation,
    mean_at,
    prepare,
    row_at,
    scale_at,
    serial_correlation,
)
from amusic_gym.estimation.sic.state import SumsState
from amusic_gym.kernels.compiling import apart, inner
from amusic_gym.kernels.tables import part

TILE = 1024
"""Places that several rows are added to in turn, so that their sums stay in the fastest cache."""

SERIAL_MEMORY = 0.98
"""Weight of the mean serial correlation so far against one more row's."""

SERIAL_MOST = 0.999
"""Above it a technique's rows would say nothing at all."""

Floats = NDArray[np.float64]


@inner
def add_row(sums: Floats, base: int, run: Run, frame: int, decay: float) -> None:
    """Multiply the window's R sums by ``decay`` and add the z-scores of a prepared row."""
    row = row_at(run, frame)
    mean = mean_at(run, frame)[0]
    scale = scale_at(run, frame)[0]
    window = sums[base : base + row.size]
    if decay != 1.0:
        for place in range(row.size):
            window[place] = decay * window[place] + deviation(row[place], mean) * scale
        return
    for place in range(row.size):
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
            prepare(run, past)  # as in remove_row
            row = row_at(run, past)
            mean = mean_at(run, past)[0]
            scale = scale_at(run, past)[0] if came else -scale_at(run, past)[0]
            window = part(sums, base + first, stop - first)
            scores = part(row, first - age, stop - first)
            for place in range(stop - first):
                window[place] += deviation(scores[place], mean) * scale
    mark.waiting, mark.leaving = 0, 0


@apart
def remove_row(sums: Floats, base: int, run: Run, frame: int, age: int, weight: float) -> None:
    """Take a frame's z-scores, ``age`` frames old, out of the sums of their diagonals."""
    prepare(run, frame)  # again in an unpickled environment, whose bank starts unprepared
    row = row_at(run, frame)
    mean = mean_at(run, frame)[0]
    scale = scale_at(run, frame)[0] * weight
    window = part(sums, base + age, row.size - age)
    for place in range(row.size - age):
        window[place] -= deviation(row[place], mean) * scale


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
def push(
    sums: Floats,
    mark: SumsState,
    run: Run,
    ran: NDArray[np.bool_],
    frame: int,
    history: int,
    gamma: float,
) -> None:
    """Add the row of ``frame`` to the running sums and let rows older than F frames go.

    Args:
        sums: (R + SLACK,) float64.
        mark: its bookkeeping.
        run: the rows; that of ``frame`` is prepared.
        ran: (Q,) the frames that the technique ran on.
        frame: frame index n, later than ``mark.last``.
        history: F.
        gamma: weight of a row per frame of age.
    """
    if mark.origin < frame:
        recentre(sums, mark, frame, run.references)
    base = mark.origin - frame
    if mark.depth > 0:
        mark.frames[mark.waiting] = frame
        mark.waiting += 1
    else:
        decay = 1.0 if gamma == 1.0 or mark.last < 0 else gamma ** (frame - mark.last)
        add_row(sums, base, run, frame, decay)
    while mark.expired < frame - history:
        age = frame - mark.expired
        # A row that came and went within one gap was never added, or has left the map; whether
        # there is one is remembered for no longer.
        if age < run.references and ran[mark.expired] and mark.expired <= mark.last:
            if mark.depth == 0:
                remove_row(sums, base, run, mark.expired, age, gamma**age)
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
        mark.serial = SERIAL_MEMORY * mark.serial + serial_correlation(run, frame)
        mark.serial_rows = SERIAL_MEMORY * mark.serial_rows + 1.0
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
