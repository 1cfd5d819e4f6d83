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
from amusic_gym.estimation.belief.rows import total
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
def add_modes(modes: NDArray[np.float64], stop: int, size: int, out: NDArray[np.float64]) -> None:
    """Sum (R,) of the first ``stop`` modes."""
    for c in range(size):
        out[c] = modes[0, c]
    for mode in range(1, stop):
        row = modes[mode]
        for c in range(size):
            out[c] += row[c]


@apart
def predict(
    modes: NDArray[np.float64],
    size: int,
    free: NDArray[np.float64],
    line: NDArray[np.float64],
) -> None:
    """Predict the belief of the next frame: steady motion or not, new speeds, motion, jumps.

    What would leave the map jumps, too; whatever jumps comes to any place, at any speed.

    Args:
        modes: (MODES, R) belief, of sum 1.
        size: R.
        free: (R,) scratch.
        line: (REACH + R + REACH_BACK,) scratch, whose first REACH entries are 0.
    """
    add_modes(modes, BACKWARDS, size, free)
    kept, steady, backwards = 0.0, modes[STEADY], modes[BACKWARDS]
    for c in range(size):
        free[c] += LASTING * backwards[c]
    mixed = part(line, REACH, size + REACH_BACK)
    mixed[size] = mixed[size + 1] = 0.0
    for mode in range(MODES):
        row = modes[mode]
        if mode == STEADY:
            keep, change, leave, jump = 1.0 - LEAVE, SETTLE, 0.0, STEADY_JUMP
        else:
            ends = LASTING if mode == BACKWARDS else 1.0
            keep, change = 1.0 - ends * (SETTLE + (1.0 - SETTLE) * CHANGE), (1.0 - SETTLE) * CHANGE
            change, leave, jump = change * SHARES[mode], LEAVE * SHARES[mode], ends * JUMP
        for c in range(size):
            mixed[c] = keep * row[c] + change * free[c] + leave * steady[c]
        p0, p1, p2, p3 = moves(mode)
        seen = part(line, REACH_BACK if mode == BACKWARDS else 0, REACH + size)
        for c in range(size):
            moved = p0 * seen[c + 3] + p1 * seen[c + 2] + p2 * seen[c + 1] + p3 * seen[c]
            row[c] = (1.0 - jump) * moved
        kept += total(row, size)
    for mode in range(SPEEDS):
        row, gain = modes[mode], (1.0 - kept) * SHARES[mode] / size
        for c in range(size):
            row[c] += gain
