"""What a step does besides the estimate, compiled: choose what runs, and show what came of it.

Between the two an estimator takes the frame (:mod:`amusic_gym.estimation.estimator`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.observation import observe
from amusic_gym.envs.outcome import PAST_END, OutcomeTable
from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.prediction import SMOOTHING
from amusic_gym.estimation.selection import select
from amusic_gym.kernels.compiling import compiled, inner
from amusic_gym.kernels.tables import Table, array, reader


class StepTable(Table):
    """What the kernels of a step read and write.

    Arrays: ``actions`` (N, A), A = S, or S + 1 with the re-select bit last.
    """

    batch: Batch
    out: OutcomeTable
    coverage: float  # E
    allow_idle: bool
    actions: NDArray[np.bool_] = array(np.bool_, "routes", "actions")


_step_at: Any = reader(StepTable)


@inner
def begin_step(step: StepTable, i: int) -> None:
    """Forget what belongs to the last step of a route."""
    route, slots = step.batch.routes[i], step.batch.slots[i]
    route.idle, route.fallback, route.technique, route.similarity = False, False, -1, 0.0
    route.selected = step.batch.wanted[i]
    for s in range(slots.size):
        slots[s].ran, slots[s].chosen = False, False
    if not route.selected:
        route.seconds = 0.0
        for s in range(slots.size):
            slots[s].selected, slots[s].tally, slots[s].late_runs = False, 0, 0


@inner
def choose_runs(step: StepTable, i: int) -> None:
    """Decide which techniques run on the frame: the selection, the action, or the fallback."""
    route, slots, action = step.batch.routes[i], step.batch.slots[i], step.actions[i]
    cheapest, count = -1, 0
    for s in range(slots.size):
        if not slots[s].present:
            continue
        if slots[s].selected if route.selected else action[s]:
            slots[s].ran = True
            count += 1
        if cheapest < 0 or slots[s].seconds < slots[cheapest].seconds:
            cheapest = s
    if count == 0 and step.allow_idle:
        route.idle = True
    elif count == 0:
        slots[cheapest].ran = True
        route.fallback = True


@inner
def charge(batch: Batch, i: int) -> None:
    """Note what runs on the route's next frame, and what it costs."""
    route, slots = batch.routes[i], batch.slots[i]
    for s in range(slots.size):
        if slots[s].present:
            batch.ran[i, s, route.frame + 1] = slots[s].ran
            if slots[s].ran:
                route.seconds += slots[s].seconds


@compiled
def select_routes(address: int) -> None:
    """Select techniques on the routes that want it, after an estimator has looked back.

    Args:
        address: of the words of a :class:`StepTable`.
    """
    step = _step_at(address)
    for i in range(step.batch.wanted.size):
        if step.batch.wanted[i]:
            select(step.batch, i, step.coverage)


@compiled
def choose_routes(address: int) -> None:
    """Decide what runs on the next frame of every active route.

    A route that has ended, which an error may have hidden from whoever steps it, stays as it is.

    Args:
        address: of the words of a :class:`StepTable`.
    """
    step = _step_at(address)
    batch = step.batch
    for i in range(batch.active.size):
        if batch.active[i] and batch.routes[i].frame + 1 >= batch.routes[i].frames:
            batch.active[i] = False
            batch.routes[i].bad_row = PAST_END
        if batch.active[i]:
            begin_step(step, i)
            choose_runs(step, i)
            charge(batch, i)


@inner
def show_step(step: StepTable, i: int) -> None:
    """Copy what belongs to the step to the outcome, and count its cost."""
    route, slots, out = step.batch.routes[i], step.batch.slots[i], step.out.routes[i]
    if route.spent >= 0.0:
        route.seconds = route.spent
    route.compute = route.seconds / route.total_seconds
    route.compute_mean += SMOOTHING * (route.compute - route.compute_mean)
    out.idle, out.fallback, out.happened = route.idle, route.fallback, route.selected
    out.technique, out.similarity, out.seconds = route.technique, route.similarity, route.seconds
    for s in range(slots.size):
        slot, shown = slots[s], step.out.slots[i, s]
        shown.selected, shown.tally, shown.late_runs = slot.selected, slot.tally, slot.late_runs
        if slot.ran:
            shown.ran = True
            shown.place = slot.place
            shown.statistic = slot.statistic
            shown.correction = slot.correction
    if route.selected:
        corrections, shown_corrections = step.batch.corrections[i], step.out.corrections[i]
        for s in range(slots.size):
            if slots[s].present:
                for past in range(min(step.batch.block, route.frame)):
                    shown_corrections[s, past] = corrections[s, past]


@inner
def show_route(step: StepTable, i: int) -> None:
    """Copy what is known of a route to the outcome."""
    route, slots, out = step.batch.routes[i], step.batch.slots[i], step.out.routes[i]
    for s in range(slots.size):
        step.out.slots[i, s].present = slots[s].present
        step.out.slots[i, s].run_seconds = slots[s].seconds
    out.route = route.bank
    out.compute_weight = route.compute_weight
    out.ended = route.frame + 1 >= route.frames
    out.frame = route.frame
    out.prediction = route.prediction
    out.confidence = route.confidence
    out.margin = route.margin
    out.p_correct = route.p_correct
    out.compute = route.compute
    out.bad_row = route.bad_row
    route.bad_row = 0
    observe(route, slots, step.out.observation[i])


@compiled
def observe_routes(address: int) -> int:
    """Write what is known of every route to the outcome, which is zeros before.

    Args:
        address: of the words of a :class:`StepTable`.

    Returns:
        Number of routes on which something is wrong; their ``bad_row`` tells what.
    """
    step = _step_at(address)
    bad_rows = 0
    for i in range(step.batch.active.size):
        if step.batch.active[i]:
            show_step(step, i)
        else:
            step.out.routes[i].technique = -1
        show_route(step, i)
        bad_rows += step.out.routes[i].bad_row != 0
    return bad_rows
