"""One step of a batch of episodes, which the single and the vector environment share.

Python says what happens in which order and answers for live routes and errors; kernels, below, do
it for every route. Between :func:`choose_routes` and :func:`observe_routes` an estimator takes the
frame (:mod:`amusic_gym.estimation.estimator`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import ArrayLike, NDArray

from amusic_gym.envs.memory import EpisodeMemory, StepTable
from amusic_gym.envs.observation import WIDTH, observe_route, observe_technique
from amusic_gym.envs.outcome import PAST_END, Outcome
from amusic_gym.estimation.prediction import SMOOTHING
from amusic_gym.estimation.selection import select
from amusic_gym.kernels.compiling import compiled, inner
from amusic_gym.kernels.tables import reader

DOUBT = 0.5
"""A frame with p̂ below this is one of doubt."""


def as_actions(actions: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Actions as booleans; values are checked, not the dtype.

    Args:
        actions: of one route or of all.
        shape: (A,) or (N, A), what they must have.

    Raises:
        ValueError: for a wrong shape or any value but 0 and 1.
    """
    given = np.asarray(actions)
    if given.shape != shape:
        raise ValueError(f"action of shape {given.shape}; the action space has {shape}")
    if given.dtype.char in "?bB":  # bytes: stripped of 0 and 1, nothing is left
        valid = not given.tobytes().strip(b"\0\1")
    else:
        valid = bool(((given == 0) | (given == 1)).all())
    if not valid:
        wrong = given[(given != 0) & (given != 1)][0]
        raise ValueError(f"action value {wrong}; MultiBinary({shape[-1]}) takes 0 and 1 only")
    return given.astype(np.bool_)


class Episodes(EpisodeMemory):
    """A batch of N routes with S technique slots each, and the step that all take."""

    def step(self, actions: NDArray[np.bool_], active: NDArray[np.bool_] | None = None) -> Outcome:
        """Take the active routes, or all, through their next frame; see the four parts.

        Raises:
            ResetNeeded: for a route that has ended.
            ValueError: for what a live route cannot read or compute, or a row with NaN or infinite
                scores.
            FileNotFoundError: for a live route's image that is gone.
        """
        self.choose(actions, active)  # which techniques run on the next frame
        self.run()  # their score rows: a bank has them, a live route computes them now
        self.estimator.update()  # SIC and MuSIC, or the belief: place, confidence, p̂
        return self.observe()  # what a robot would know

    def choose(self, actions: NDArray[np.bool_], active: NDArray[np.bool_] | None = None) -> None:
        """Decide which techniques run on the next frame of the active routes.

        Args:
            actions: (N, S), or (N, S + 1) with the re-select bit last.
            active: (N,) routes to step; None: all. A live route whose source has ended is none.

        Raises:
            ValueError: for what a live route cannot read, or a step after such an error.
            FileNotFoundError: for a live route's image that is gone.
        """
        self._actions[...] = actions
        self.state.active[...] = True if active is None else active
        live = self._look_ahead() if self.is_live else []
        batch = self.state  # after the look ahead, which may have made room
        if self.block and (live or self._actions[:, -1].any()):
            batch.wanted[:] = batch.active & self._actions[:, -1] & (batch.routes["frame"] >= 0)
            batch.lagging[:] = False
            batch.lagging[live] = True
            for i in live:
                self._compute(i, self._missed(i) if batch.wanted[i] else [])
            batch.slots["late_runs"] = 0
            self.estimator.look_back()
            select_routes(self._address)
        else:
            batch.wanted[:] = False
        choose_routes(self._address)

    def run(self) -> None:
        """Run the chosen techniques: a bank's rows are there, a live route's are computed now.

        Raises:
            ValueError: for what a technique of a live route cannot compute.
        """
        if self.is_live:
            for i in self._live():
                frame = int(self.state.routes[i]["frame"]) + 1
                ran = np.flatnonzero(self.state.slots["ran"][i]).tolist()
                self._compute(i, [(s, frame) for s in ran])

    def observe(self) -> Outcome:
        """What the step came to, the others shown as they are; its memory is the caller's.

        Raises:
            ResetNeeded: for a route that has ended.
            ValueError: for a row with NaN or infinite scores, naming technique and frame.
        """
        self.shown.fill(0)
        bad_rows = observe_routes(self._address)
        if self.is_live:
            self._broken &= ~self.state.active
        record: Any = np.ndarray((), self.layout, self.shown.copy())
        out = Outcome(
            record["routes"], record["slots"], record["corrections"], record["observation"]
        )
        if bad_rows:
            self._refuse(out.routes["bad_row"])
        return out

    def look(self) -> Outcome:
        """Show every route as it is, without a step."""
        self.state.active[...] = False
        return self.observe()

    def _refuse(self, bad: NDArray[np.int64]) -> None:
        i = int(np.flatnonzero(bad)[0])
        if bad[i] == PAST_END:
            raise ResetNeeded(
                f"route {i} has ended, in a step that an error cut short; reset it before the next"
            )
        route = self.routes[i]
        assert route is not None
        slot, frame = divmod(int(bad[i]) - 1, route.frames)
        technique = route.bank.techniques[route.columns[slot]]
        raise ValueError(
            f"score bank {route.bank.name!r}: NaN or infinite score of technique {technique!r} at"
            f" frame {route.start + frame}; mend the scores and write the bank again"
        )

    # --- live routes ----------------------------------------------------------------------------

    def _live(self) -> list[int]:
        """Active live routes."""
        active = np.flatnonzero(self.state.active).tolist()
        return [i for i in active if self.drives[i] is not None]

    def _look_ahead(self) -> list[int]:
        """Read the images of the next frame; routes whose source has ended take no step.

        Returns:
            The live routes that do.
        """
        if self._broken[self.state.active].any():
            raise ValueError("an error cut the last step short; call reset() before the next")
        for i in self._live():
            drive, record = self.drives[i], self.state.routes[i]
            assert drive is not None
            frame = int(record["frame"]) + 1
            self.state.active[i] = drive.advance(frame)
            if not self.state.active[i]:
                record["frames"] = frame
            elif drive.frames is not None:
                record["frames"] = drive.frames
            if frame - self.state.gone >= self.room["frames"]:
                self._remember_more()
        self._broken |= self.state.active
        return self._live()

    def _missed(self, i: int) -> list[tuple[int, int]]:
        """(slot, frame) of what did not run on the last M frames; a selection looks at it."""
        frame, present = self.state.routes[i]["frame"] + 1, self.state.slots[i]["present"]
        first, gone = max(0, frame - self.block), self.state.gone
        missed = ~self.state.ran[i, :, first - gone : frame - gone] & present[:, None]
        return [(int(s), int(first + past)) for s, past in np.argwhere(missed)]

    def _compute(self, i: int, wanted: list[tuple[int, int]]) -> None:
        """Run techniques of a live route on frames, and let the kernels know where the rows are."""
        route, drive = self.routes[i], self.drives[i]
        assert route is not None
        assert drive is not None
        for s, frame in wanted:
            drive.run(int(route.columns[s]), frame)
        if drive.moved:
            drive.point(self.state.runs[i], route.columns)
        if drive.route.charge_wall_time:
            self.state.routes["spent"][i] = drive.spent


_step_at: Any = reader(StepTable)


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


@inner
def choose_runs(step: StepTable, i: int) -> None:
    """Decide which techniques run on a route's next frame, and what they cost.

    Those of the selection, or of the action; where it names none, the cheapest, or nothing.
    """
    route, slots, action = step.batch.routes[i], step.batch.slots[i], step.actions[i]
    route.technique, route.similarity = -1, 0.0
    route.selected = step.batch.wanted[i]
    if not route.selected:
        route.seconds = 0.0
    cheapest, count = -1, 0
    for s in range(slots.size):
        slot = slots[s]
        slot.ran, slot.chosen = False, False
        if not route.selected:
            slot.selected, slot.tally, slot.late_runs = False, 0, 0
        if slot.present:
            slot.ran = slot.selected if route.selected else action[s]
            count += slot.ran
            if cheapest < 0 or slot.seconds < slots[cheapest].seconds:
                cheapest = s
    route.idle = count == 0 and step.allow_idle
    route.fallback = count == 0 and not step.allow_idle
    if route.fallback:
        slots[cheapest].ran = True
    for s in range(slots.size):
        if slots[s].present:
            step.batch.ran[i, s, route.frame + 1] = slots[s].ran
            if slots[s].ran:
                route.seconds += slots[s].seconds


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
            choose_runs(step, i)


@inner
def show_step(step: StepTable, i: int) -> None:
    """Copy what belongs to the step to the outcome; running means of its cost and of p̂."""
    route, slots, out = step.batch.routes[i], step.batch.slots[i], step.out.routes[i]
    if route.spent >= 0.0:
        route.seconds = route.spent
    route.compute = route.seconds / route.total_seconds
    route.compute_mean += SMOOTHING * (route.compute - route.compute_mean)
    route.p_correct_mean += SMOOTHING * (route.p_correct - route.p_correct_mean)
    route.since_doubt = 0.0 if route.p_correct < DOUBT else route.since_doubt + 1.0
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
    """Copy what is known of a route to the outcome, and write its observation."""
    route, slots, out = step.batch.routes[i], step.batch.slots[i], step.out.routes[i]
    observation = step.out.observation[i]
    for s in range(slots.size):
        step.out.slots[i, s].present = slots[s].present
        step.out.slots[i, s].run_seconds = slots[s].seconds
        if slots[s].present:
            observe_technique(slots[s], route, observation[s * WIDTH : (s + 1) * WIDTH])
    observe_route(route, observation[slots.size * WIDTH :])
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
