"""The selection of A-MuSIC (III-C1), compiled: techniques that cover MuSIC's choices of a block."""

from __future__ import annotations

import math
from typing import Any

from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.prediction import first_near
from amusic_gym.kernels.compiling import apart


@apart
def take_techniques(slots: Any, frames: int, coverage: float) -> None:
    """Take techniques (S,) by falling tally until it covers the block; ties to the lower index."""
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
def select(batch: Batch, i: int, coverage: float) -> None:
    """Select techniques by the statistics of the last block, and charge its late runs."""
    route, slots = batch.routes[i], batch.slots[i]
    size = min(batch.block, route.frame + 1)
    route.seconds = 0.0
    for s in range(slots.size):
        slots[s].selected, slots[s].tally = False, 0
        route.seconds += slots[s].late_runs * slots[s].seconds
    for past in range(size):
        statistics, best = batch.statistics[i, past], -math.inf
        for s in range(slots.size):
            best = max(best, statistics[s])
        slots[first_near(statistics, best, slots.size)].tally += 1
    take_techniques(slots, size, coverage)
