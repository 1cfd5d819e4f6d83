"""How the belief moves from one frame to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.belief.model import (
    BACKWARDS,
    CHANGE,
    JUMP,
    LASTING,
    LEAVE,
    MODES,
    REACH,
    REACH_BACK,
    SETTLE,
    SHARES,
    SLACK,
    SPEEDS,
    STEADY,
    STEADY_JUMP,
)
from amusic_gym.estimation.belief.rows import ZERO, single, total
from amusic_gym.kernels.compiling import apart, inner
from amusic_gym.kernels.tables import part


@inner
def moves(mode: int) -> tuple[float, float, float, float]:
    """Probabilities that a mode goes 0, 1, 2 or 3 places in a frame; backwards: −2, −1, 0 or 1."""
    if mode == 0:
        return 1.0 - SLACK, SLACK, 0.0, 0.0
    if mode == 1:
        return 0.5, 0.5, 0.0, 0.0
    if mode in (2, BACKWARDS):
        return SLACK, 1.0 - 2.0 * SLACK, SLACK, 0.0
    if mode == 3:
        return 0.0, 0.5, 0.5, 0.0
    if mode == STEADY:
        return 0.0, 1.0, 0.0, 0.0
    return 0.0, SLACK, 1.0 - 2.0 * SLACK, SLACK


@apart
def add_modes(modes: NDArray[np.float32], stop: int, size: int, out: NDArray[np.float32]) -> None:
    """Sum (R,) of the first ``stop`` modes."""
    for c in range(size):
        out[c] = modes[0, c]
    for mode in range(1, stop):
        row = modes[mode]
        for c in range(size):
            out[c] += row[c]


@apart
def predict(
    modes: NDArray[np.float32],
    size: int,
    free: NDArray[np.float32],
    line: NDArray[np.float32],
) -> None:
    """Predict the belief of the next frame: steady motion or not, new speeds, motion, jumps.

    What would leave the map jumps, too; whatever jumps comes to any place, at any speed.

    Args:
        modes: (MODES, R) belief, of sum 1.
        size: R.
        free: (R,) scratch.
        line: (REACH + R + REACH_BACK,) scratch, or longer.
    """
    add_modes(modes, BACKWARDS, size, free)
    lost, steady, backwards, lasting = 0.0, modes[STEADY], modes[BACKWARDS], single(LASTING)
    for c in range(size):
        free[c] += lasting * backwards[c]
    mixed = part(line, REACH, size + REACH_BACK)
    line[0] = line[1] = line[2] = mixed[size] = mixed[size + 1] = ZERO
    for mode in range(MODES):
        row = modes[mode]
        if mode == STEADY:
            keep, change, leave, jump = 1.0 - LEAVE, SETTLE, 0.0, STEADY_JUMP
        else:
            ends = LASTING if mode == BACKWARDS else 1.0
            keep, change = 1.0 - ends * (SETTLE + (1.0 - SETTLE) * CHANGE), (1.0 - SETTLE) * CHANGE
            change, leave, jump = change * SHARES[mode], LEAVE * SHARES[mode], ends * JUMP
        a, b, d = single(keep), single(change), single(leave)
        for c in range(size):
            mixed[c] = a * row[c] + b * free[c] + d * steady[c]
        chances = moves(mode)
        stay = 1.0 - jump
        p0, p1 = single(stay * chances[0]), single(stay * chances[1])
        p2, p3 = single(stay * chances[2]), single(stay * chances[3])
        if mode == BACKWARDS:
            seen = part(line, REACH_BACK, REACH + size)
            off = (p0 + p1) * mixed[0] + p0 * mixed[1]
        else:
            seen = part(line, 0, REACH + size)
            end = part(line, size, REACH)
            off = p3 * end[0] + (p2 + p3) * end[1] + (p1 + p2 + p3) * end[2]
        c0, c1, c2 = part(seen, 3, size), part(seen, 2, size), part(seen, 1, size)
        for c in range(size):
            row[c] = p0 * c0[c] + p1 * c1[c] + p2 * c2[c] + p3 * seen[c]
        lost += off + jump / stay * (total(row, size) + off)
    for mode in range(SPEEDS):
        row, gain = modes[mode], single(lost * SHARES[mode] / size)
        for c in range(size):
            row[c] += gain
