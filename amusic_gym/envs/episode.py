"""Episodes: the batch of routes that the single and the vector environment share.

:class:`Episodes` owns the arrays, begins routes and steps them; the arithmetic is in
:mod:`amusic_gym.estimation.dynamics`. The single environment is a batch of one.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.rows import RUN
from amusic_gym.envs.live_route import ENDLESS
from amusic_gym.envs.sources import Recording
from amusic_gym.estimation import belief
from amusic_gym.estimation.belief import Minds
from amusic_gym.estimation.calibration import coefficients
from amusic_gym.estimation.dynamics import PLAN, PROCESS, SHOW, step_beliefs, step_routes
from amusic_gym.estimation.observation import declare_costs
from amusic_gym.estimation.records import (
    BATCH,
    PAST_END,
    ROUTE,
    SLOT,
    Batch,
    Outcome,
    OutcomeShape,
    Rules,
    State,
)
from amusic_gym.estimation.selection import select_routes
from amusic_gym.estimation.settings import COVERAGE, SICSettings
from amusic_gym.estimation.sic import CARRIED, SLACK, SUMS, factors_of, new_sums

if TYPE_CHECKING:
    from amusic_gym.envs.live_rows import LiveRows

KEPT = (
    *("routes", "slots", "runs", "marks", "sums", "ran", "counts", "prefix"),
    *("places", "predictions"),
)
"""Arrays of the state that go on when there must be more room; the others are scratch."""

KEPT_BELIEF = ("minds", "witnesses", "belief", "hubs")
"""Those of the belief's memory."""

ROOM = 1024
"""Frames that there is room for at first on such a route; it doubles when it is used up."""


@dataclass(frozen=True)
class Route:
    """What one episode runs on.

    Attributes:
        bank: where the score rows come from: a bank, or a live route.
        start: the bank's query that is frame 0.
        frames: length of the route, `ENDLESS` where it is not known.
        columns: (S,) technique of the bank in each slot, −1 for an empty slot.
        compute_weight: λ of the episode's reward.
        index: the bank's number in the environment's list.
    """

    bank: Recording
    start: int
    frames: int
    columns: NDArray[np.int64]
    compute_weight: float
    index: int


class Episodes:
    """A batch of N routes with S technique slots each.

    Args:
        num_routes: N.
        slots: S.
        settings: statistic, K, F and γ of SIC.
        reselection: M, or 0 for actions without a re-select bit.
        coverage: E, share of MuSIC's choices that a selection covers.
        allow_idle: whether an empty action runs nothing, instead of the cheapest technique.
        threads: of the belief.
    """

    def __init__(
        self,
        num_routes: int,
        slots: int,
        settings: SICSettings,
        *,
        reselection: int = 0,
        coverage: float = COVERAGE,
        allow_idle: bool = False,
        threads: int = 1,
    ) -> None:
        self._threads = threads
        self.num_routes = num_routes
        self.slots = slots
        self.settings = settings
        self.routes: list[Route | None] = [None] * num_routes
        self.drives: list[LiveRows | None] = [None] * num_routes  # of the live routes
        self.is_live = False  # whether there is any
        self._broken = np.zeros(num_routes, np.bool_)  # (N,) cut short by an error
        self.rules = Rules(
            history=settings.history,
            gamma=float(settings.gamma),
            evidence=settings.statistic == "evidence",
            belief=settings.statistic == "belief",
            carry=bool(settings.carry),
            block=reselection,
            coverage=coverage,
            allow_idle=allow_idle,
            calibration=coefficients(settings.statistic).copy(),
        )
        self.stepped = np.zeros(num_routes, np.bool_)  # (N,) processed a frame in the last step
        self._wanted, self._lagging = np.zeros((2, num_routes), np.bool_)  # see belief.Hearing
        self._actions = np.zeros((num_routes, self.action_size), np.bool_)
        self._out = Outcome(OutcomeShape(num_routes, slots, reselection))  # of the last step
        self._room = (1, 1, 1)  # places, frames and candidates that there is room for
        self.state, self.minds = self._allocate(*self._room)
        self._lay_out()

    def _allocate(self, references: int, frames: int, candidates: int) -> tuple[State, Minds]:
        n, s = self.num_routes, self.slots
        sets = 2 if self.rules.block else 1
        mapped, summed = (references, 0) if self.rules.belief else (0, references + SLACK)
        minds = belief.allocate(belief.fitted(), sets, n, s, mapped)
        state = State(
            routes=np.zeros(n, ROUTE),
            slots=np.zeros((n, s), SLOT),
            runs=np.zeros((n, s), RUN),
            marks=np.zeros((2, n, s), SUMS),
            sums=np.zeros((sets, n, s, summed)),
            ran=np.zeros((n, s, frames), np.uint8),
            counts=np.zeros((n, s, frames + 1), np.int32),
            prefix=np.zeros((n, s, 0 if self.rules.gamma == 1.0 else frames + 1)),
            places=np.zeros((n, s, frames if self._replays else 0), np.int32),
            predictions=np.zeros((n, frames if self._replays else 0), np.int32),
            values=np.zeros((s, candidates + CARRIED)),
            carried=np.zeros((s, CARRIED), np.int64),
            scratch=np.zeros(s),
            factors=factors_of(min(self.settings.history, references) + 1, self.rules.evidence),
            minds=minds.minds[0],
            witnesses=minds.witnesses[0],
            late=np.zeros((n, s), np.int64),
            statistics=np.zeros((n, self.rules.block, s)),
            corrections=np.zeros((n, s, self.rules.block)),
        )
        return state, minds

    def _make_room(self, references: int, frames: int) -> None:
        """Grow the arrays for a route of that size, keeping the other routes' memory."""
        wanted = (references, frames, min(self.settings.candidates, references))
        places, queries, ranked = (max(pair) for pair in zip(wanted, self._room, strict=True))
        room = (places, queries, ranked)
        if room == self._room:
            return
        old, old_minds = self.state, self.minds
        new, minds = self._allocate(*room)
        self._room = room
        for name in KEPT:
            _keep(getattr(old, name), getattr(new, name))
        for name in KEPT_BELIEF:
            _keep(getattr(old_minds, name), getattr(minds, name))
        self.state, self.minds = new, minds
        self._lay_out()

    def _lay_out(self) -> None:
        """Write the tables that the kernels read; to be done again when an array is replaced."""
        state = self.state
        batch = Batch(state, self.rules, self.stepped, self._actions, self._out)
        self._batch = BATCH.write(batch)
        self._address: int = self._batch.ctypes.data
        hearing = belief.Hearing(
            minds=self.minds,
            active=self.stepped,
            wanted=self._wanted,
            lagging=self._lagging,
            block=self.rules.block,
            routes=state.routes,
            slots=state.slots,
            runs=state.runs,
            ran=state.ran,
            late=state.late,
            statistics=state.statistics,
            corrections=state.corrections,
        )
        self._hearers = belief.Hearers(hearing, self._threads)

    def begin(self, i: int, route: Route) -> None:
        """Start ``route`` as number ``i`` of the batch; nothing has run on it yet."""
        bank = route.bank
        self._make_room(bank.references, ROOM if route.frames == ENDLESS else route.frames)
        self.drives[i] = (
            None
            if isinstance(bank, ScoreBank)
            else bank.drive(route.start, self.settings, self.rules.block)
        )
        if self.is_live or self.drives[i] is not None:
            self.is_live = any(drive is not None for drive in self.drives)
        self._broken[i] = False
        self.routes[i] = route
        state = self.state
        for array in (state.sums[:, i], state.ran[i], state.counts[i], state.prefix[i]):
            array.fill(0)
        record = state.routes[i : i + 1]
        record[:] = np.zeros(1, ROUTE)
        record["frame"] = -1
        record["frames"] = route.frames
        record["bank"] = route.index
        record["references"] = bank.references
        record["tolerance"] = bank.tolerance
        record["compute_weight"] = route.compute_weight
        record["prediction"] = -1
        record["spent"] = -1.0
        present = route.columns >= 0
        record["total_seconds"] = bank.seconds[route.columns[present]].sum()
        slots = state.slots[i]
        slots[:] = np.zeros(self.slots, SLOT)
        slots["present"] = present
        slots["last_run"] = -1
        slots["seconds"][present] = bank.seconds[route.columns[present]]
        declare_costs(record, slots)
        if self.rules.belief:
            belief.begin(self.minds, i, bank.references)
        new_sums(state.marks[:, i], bank.references, state.sums.shape[-1], self.settings)
        self._point(i)

    def _point(self, i: int) -> None:
        """Write the addresses of a route's rows."""
        route = self.routes[i]
        if route is None:
            return
        bank, runs, drive = route.bank, self.state.runs[i], self.drives[i]
        runs[:] = np.zeros(self.slots, RUN)
        if drive is not None:
            drive.point(runs, route.columns)
            return
        assert isinstance(bank, ScoreBank)
        runs["start"] = route.start
        columns = np.maximum(route.columns, 0)  # an empty slot's are never read
        bank.prepared(self.settings.candidates).point(runs, columns)

    def step(self, actions: NDArray[np.bool_], active: NDArray[np.bool_] | None = None) -> Outcome:
        """Process the next frame of the active routes; the others are shown as they are.

        A live route whose source has ended is shown as it is, too: :attr:`stepped` tells.

        Args:
            actions: (N, S), or (N, S + 1) with the re-select bit last.
            active: (N,) routes to step; None: all.

        Raises:
            ResetNeeded: for a route that has ended.
            ValueError: for a row with NaN or infinite scores, naming technique and frame; for
                what a live route cannot compute, or a step after such an error.
            FileNotFoundError: for a live route's image that is gone.
        """
        self._actions[...] = actions
        self.stepped[...] = True if active is None else active
        self._out.memory.fill(0)
        if self.is_live:
            bad_rows = self._step_live()
        else:
            self._select([])
            bad_rows = self._run_stages(PLAN | PROCESS | SHOW)
        out = self._out.copy()
        if bad_rows:
            self._refuse(out.routes["bad_row"])
        return out

    def _select(self, live: Sequence[int]) -> None:
        """Do a selection where it is asked for."""
        if self.rules.block and (live or self._actions[:, -1].any()):
            if self.rules.belief:
                self._look_back()
            select_routes(self._address)

    def _run_stages(self, stages: int) -> int:
        """Run stages of a step; returns the number of routes with a row that is not finite."""
        if not self.rules.belief:
            return step_routes(self._address, stages)
        if stages & PLAN:
            step_beliefs(self._address, PLAN)
        if stages & PROCESS:
            self._hearers.hear()
        return step_beliefs(self._address, stages & ~PLAN)

    def _step_live(self) -> int:
        """A step with live routes: let their techniques run between the plan and its processing."""
        if self._broken[self.stepped].any():
            raise ValueError("an error cut the last step short; call reset() before the next")
        live = [i for i in np.flatnonzero(self.stepped).tolist() if self.drives[i] is not None]
        self._look_ahead(live)
        self._broken |= self.stepped
        live = [i for i in live if self.stepped[i]]
        for i in live:
            self._compute(i, self._missed(i) if self.rules.block and self._actions[i, -1] else [])
        self._select(live)
        self._run_stages(PLAN)
        for i in live:
            frame = int(self.state.routes[i]["frame"]) + 1
            self._compute(
                i, [(s, frame) for s in np.flatnonzero(self._out.slots["ran"][i]).tolist()]
            )
        bad_rows = self._run_stages(PROCESS | SHOW)
        self._broken &= ~self.stepped
        return bad_rows

    def _look_back(self) -> None:
        """Let the belief go through the last block again where a selection is asked for."""
        frames, live = self.state.routes["frame"], [drive is not None for drive in self.drives]
        self.state.late.fill(0)
        self._wanted[:] = self.stepped & self._actions[:, -1] & (frames >= 0)
        self._lagging[:] = self.stepped & live
        self._hearers.look_back()

    def _look_ahead(self, live: Sequence[int]) -> None:
        """Read the images of the next frame; routes whose source has ended take no step."""
        for i in live:
            drive, record = self.drives[i], self.state.routes[i]
            assert drive is not None
            frame = int(record["frame"]) + 1
            self.stepped[i] = drive.advance(frame)
            if not self.stepped[i]:
                record["frames"] = frame
            elif drive.frames is not None:
                record["frames"] = drive.frames
            if frame >= self.state.ran.shape[-1]:
                self._make_room(1, 2 * self.state.ran.shape[-1])

    def _missed(self, i: int) -> list[tuple[int, int]]:
        """(slot, frame) of what did not run on the last M frames; a selection looks at it."""
        frame, present = self.state.routes[i]["frame"] + 1, self.state.slots[i]["present"] > 0
        first = max(0, frame - self.rules.block)
        missed = (self.state.ran[i, :, first:frame] == 0) & present[:, None]
        return [(int(s), int(first + past)) for s, past in np.argwhere(missed)]

    def _compute(self, i: int, wanted: Sequence[tuple[int, int]]) -> None:
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

    def look(self) -> Outcome:
        """Show every route as it is, without a step."""
        self.stepped[...] = False
        self._out.memory.fill(0)
        self._run_stages(SHOW)
        return self._out.copy()

    def repeated(self, copies: int) -> Episodes:
        """A batch in which every route stands ``copies`` times in a row, each as it is now.

        Raises:
            ValueError: for live routes: the future of a camera can't be had several times.
        """
        if self.is_live:
            raise ValueError("a live route cannot be copied; give score banks")
        routes = self.num_routes * copies
        twin = type(self)(
            routes,
            self.slots,
            self.settings,
            reselection=self.rules.block,
            coverage=self.rules.coverage,
            allow_idle=self.rules.allow_idle,
            threads=self._threads,
        )
        twin.routes = [route for route in self.routes for _ in range(copies)]
        twin._make_room(self._room[0], self._room[1])
        for name in KEPT:
            axis = 1 if name in ("marks", "sums") else 0
            getattr(twin.state, name)[...] = np.repeat(getattr(self.state, name), copies, axis)
        for name in KEPT_BELIEF:
            getattr(twin.minds, name)[...] = np.repeat(getattr(self.minds, name), copies, 1)
        return twin

    @property
    def _replays(self) -> bool:
        """Whether selections go through SIC's last frames again."""
        return self.rules.block > 0 and not self.rules.belief

    @property
    def action_size(self) -> int:
        """S, and one more for the re-select bit."""
        return self.slots + (self.rules.block > 0)

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

    def __getstate__(self) -> dict[str, Any]:
        """All but what is made of the rest."""
        return {name: value for name, value in self.__dict__.items() if name != "_hearers"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and write the addresses of its own banks' rows."""
        self.__dict__.update(state)
        minds, witnesses = self.minds.minds[0], self.minds.witnesses[0]  # views again
        self.state = self.state._replace(minds=minds, witnesses=witnesses)
        self._lay_out()
        for i in range(self.num_routes):
            self._point(i)

    def __deepcopy__(self, memo: dict[int, Any]) -> Episodes:
        twin = type(self).__new__(type(self))
        memo[id(self)] = twin
        twin.__setstate__({k: copy.deepcopy(v, memo) for k, v in self.__getstate__().items()})
        return twin


def _keep(old: NDArray[Any], new: NDArray[Any]) -> None:
    """Copy an array into the corner of a larger one."""
    new[tuple(slice(0, size) for size in old.shape)] = old
