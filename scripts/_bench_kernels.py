"""Compiled loops that the bench times: the package's own SIC over many routes, and plain streams.

The functions called are those that the environment calls; only the loops around them are here.
"""

from __future__ import annotations

from typing import Any

from amusic_gym.banks.rows import top_at
from amusic_gym.estimation.sic import best_candidate, candidate_at, push, weigh
from amusic_gym.kernels.compiling import compiled

BYTES_PER_PLACE = 4 + 8 + 8  # read a float32 score, read and write a float64 sum


@compiled
def correct_routes(
    sums: Any,
    marks: Any,
    runs: Any,
    ran: Any,
    counts: Any,
    prefix: Any,
    values: Any,
    carried: Any,
    factors: Any,
    frame: int,
    history: int,
    places: Any,
    statistics: Any,
) -> None:
    """One SIC correction on each of N routes at ``frame``, statistic `evidence`, γ = 1.

    Args:
        sums: (N, R + SLACK) float64.
        marks: (N,) SUMS records.
        runs: (N,) RUN records; their rows are prepared.
        ran: (N, Q) uint8.
        counts: (N, Q + 1) int32, see ``sic.weigh``.
        prefix: (N, 0) float64, not used where γ = 1.
        values: (K + CARRIED,) float64 scratch.
        carried: (CARRIED,) int64, −1: nothing is carried on.
        factors: (F + 2,) float64, see ``sic.factors_of``.
        frame: frame index.
        history: F.
        places: (N,) int64, to fill with the corrected matches.
        statistics: (N,) float64, to fill with their statistics.
    """
    for i in range(places.size):
        ran[i, frame] = 1
        weigh(counts[i], prefix[i], ran[i], frame, frame + 1, 1.0)
        push(sums[i], marks[i], runs[i], ran[i], frame, history, 1.0)
        winner = best_candidate(
            *(sums[i], marks[i], runs[i], counts[i], prefix[i], factors),
            *(frame, history, 1.0, True, carried, values),
        )
        places[i] = candidate_at(top_at(runs[i], frame), carried, winner)
        statistics[i] = values[winner]


@compiled
def push_routes(sums: Any, marks: Any, runs: Any, ran: Any, frame: int, history: int) -> None:
    """Only the accumulator's part of :func:`correct_routes`: add the frame's row of N routes."""
    for i in range(marks.size):
        push(sums[i], marks[i], runs[i], ran[i], frame, history, 1.0)


@compiled
def stream(rows: Any, windows: Any) -> None:
    """Add float32 rows (N, R) to float64 windows (N, R): the least that any accumulator does."""
    for i in range(rows.shape[0]):
        row, window = rows[i], windows[i]
        for place in range(row.size):
            window[place] += row[place]
