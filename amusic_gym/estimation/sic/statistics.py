"""Statistics of candidates from the running sums, compiled (A-MuSIC, III-A)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import (
    Run,
    deviation,
    is_masked,
    mean_at,
    prepare,
    row_at,
    scale_at,
    top_at,
)
from amusic_gym.estimation.prediction import first_near
from amusic_gym.estimation.sic.state import CARRIED, LIVE, SICState, SumsState
from amusic_gym.kernels.compiling import apart, compiled, inner

Floats = NDArray[np.float64]
Places = NDArray[np.int32]


@compiled
def weigh(
    counts: NDArray[np.int32],
    prefix: Floats,
    ran: NDArray[np.bool_],
    first: int,
    stop: int,
    ratio: float,
) -> None:
    """Extend what weights are made of, from frame ``first`` on to before ``stop``.

    Args:
        counts: (Q + 1,); ``counts[p + 1]`` is how many of the frames i ≤ p ran.
        prefix: (Q + 1,); ``prefix[p + 1]`` = Σ ratio^(p−i) over these. Not used where the ratio is
            1: counts are the same, in half the memory.
        ran: (Q,).
        first: first new frame.
        stop: frame after the last.
        ratio: γ² for evidence and γ for mean.
    """
    for frame in range(first, stop):
        counts[frame + 1] = counts[frame] + ran[frame]
        if ratio != 1.0:
            prefix[frame + 1] = ratio * prefix[frame] + ran[frame]


@compiled
def ratio_of(gamma: float, evidence: bool) -> float:
    """What the weights of two neighbouring frames differ by: γ² in Σw², γ in Σw."""
    return gamma * gamma if evidence else gamma


def factors_of(most: int, evidence: bool) -> Floats:
    """(most + 1,) factors that make statistics of the sums of so many rows, where γ = 1.

    To look them up is faster than a root and a division for every candidate.
    """
    counts = np.maximum(np.arange(most + 1.0), 1.0)
    factors: Floats = 1.0 / (np.sqrt(counts) if evidence else counts)
    return factors


@inner
def z_of(run: Run, frame: int, place: int) -> float:
    """Z-score of a place in a row."""
    prepare(run, frame)  # again in an unpickled environment, whose bank starts unprepared
    off = deviation(row_at(run, frame)[place], mean_at(run, frame)[0])
    z: float = off * scale_at(run, frame)[0]
    return z


@apart
def with_waiting(total: float, mark: SumsState, run: Run, frame: int, place: int) -> float:
    """The sum of a place at ``frame`` with what the rows that wait will change of it."""
    for k in range(mark.waiting):
        at = place - (frame - mark.frames[k])
        if at >= 0:
            total += z_of(run, mark.frames[k], at)
    for k in range(mark.leaving):
        at = place - (frame - mark.left[k])
        if at >= 0:
            total -= z_of(run, mark.left[k], at)
    return total


@inner
def discounted(total: float, weight: float, evidence: bool) -> float:
    """Statistic of a diagonal's sum where γ < 1: Σwz/√Σw² (evidence) or Σwz/Σw (mean)."""
    return total / math.sqrt(weight) if evidence else total / weight


@inner
def score_places(
    state: SICState, i: int, s: int, frame: int, places: Places, size: int, out: Floats
) -> float:
    """Write the statistics of places of the map at ``frame`` to ``out``, and return the highest.

    The walk back of a candidate (A-MuSIC, III-A) stops at the start of the history, of the run or
    of the map, whichever is nearest.

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
    gamma, evidence = state.gamma, state.evidence
    ratio = ratio_of(gamma, evidence)
    reach = min(state.history, frame)
    waits = mark.waiting + mark.leaving > 0
    every = gamma == 1.0 and frame - reach >= mark.since  # it ran on all frames that count
    newest = counts[frame + 1]
    best = -math.inf
    for k in range(size):
        place = places[k]
        span = min(reach, place)
        total = window[np.uintp(place)]  # unsigned: no check for a negative index
        if waits:
            total = with_waiting(total, mark, run, frame, place)
        before = np.uintp(frame - span)
        if gamma == 1.0:
            rows = span + 1 if every else newest - counts[before]
            statistic = total * factors[np.uintp(rows)]
        else:
            weight = prefix[frame + 1] - prefix[before] * ratio ** (span + 1)
            statistic = discounted(total, weight, evidence)
        out[k] = statistic
        best = max(best, statistic)
    return best


@inner
def candidate_at(top: Places, carried: Places, rank: int) -> int:
    """Place of a candidate: the top K of the row come first, then those carried on, −1 for none."""
    place: int = top[rank] if rank < top.size else carried[rank - top.size]
    return place


@inner
def shut_out(run: Run, frame: int, top: Places, out: Floats) -> int:
    """Give −∞ to what ranks last and is no candidate; returns how many others there are."""
    size: int = top.size
    while is_masked(run, frame, top[size - 1]):
        size -= 1
        out[size] = -math.inf
    return size


@inner
def best_candidate(state: SICState, i: int, s: int, frame: int) -> int:
    """Write the statistics of a row's candidates to ``state.values[s]`` (K + CARRIED,).

    Those that are carried on stand in ``state.carried[s]``; those off the map get −∞, and so do
    places that are no candidates in the row.

    Returns:
        Rank of the candidate of the highest statistic; of equal ones the first.
    """
    run, carried, values = state.batch.runs[i, s], state.carried[s], state.values[s]
    top = top_at(run, frame)
    best = score_places(state, i, s, frame, top, shut_out(run, frame, top, values), values)
    for k in range(CARRIED):
        place = carried[k]
        values[top.size + k] = -math.inf
        if 0 <= place < run.references and not is_masked(run, frame, place):
            out = values[top.size + k :]
            best = max(best, score_places(state, i, s, frame, carried[k:], 1, out))
    return first_near(values, best, top.size + CARRIED)


@inner
def value_beyond(values: Floats, top: Places, rank: int, place: int, tolerance: int) -> float:
    """Statistic of a candidate beyond ``tolerance`` of ``place``; −∞ for one within it."""
    value: float = values[rank] if abs(top[rank] - place) > tolerance else -math.inf
    return value


@inner
def best_rival(values: Floats, top: Places, carried: Places, place: int, tolerance: int) -> float:
    """Highest statistic of the candidates beyond ``tolerance`` of ``place``; −∞ if there are none.

    In four lanes: comparisons of one chain wait for each other.
    """
    a, b, c, d = -math.inf, -math.inf, -math.inf, -math.inf
    size = top.size
    even = size - size % 4
    for i in range(0, even, 4):
        a = max(a, value_beyond(values, top, i, place, tolerance))
        b = max(b, value_beyond(values, top, i + 1, place, tolerance))
        c = max(c, value_beyond(values, top, i + 2, place, tolerance))
        d = max(d, value_beyond(values, top, i + 3, place, tolerance))
    for i in range(even, size):
        a = max(a, value_beyond(values, top, i, place, tolerance))
    for k in range(CARRIED):
        if abs(carried[k] - place) > tolerance:
            b = max(b, values[size + k])
    return max(max(a, b), max(c, d))
