"""Episodes: the batch of routes that the single and the vector environment share.

:class:`Episodes` owns the arrays, begins routes and takes them through the parts of a step; the
single environment is a batch of one. The arithmetic is in :mod:`amusic_gym.envs.step` and in an
estimator (:mod:`amusic_gym.estimation.estimator`).
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.rows import Run
from amusic_gym.envs.live_route import ENDLESS
from amusic_gym.envs.observation import declare_costs
from amusic_gym.envs.outcome import PAST_END, Outcome, OutcomeShape
from amusic_gym.envs.sources import Recording
from amusic_gym.envs.step import StepTable, choose_routes, observe_routes, select_routes
from amusic_gym.estimation.batch import Batch, RouteState, SlotState
from amusic_gym.estimation.estimator import make_estimator
from amusic_gym.estimation.settings import COVERAGE, SICSettings

if TYPE_CHECKING:
    from amusic_gym.envs.live_rows import LiveRows

ROOM = 1024
"""Frames that there is room for at first on a route of unknown length; it doubles when used up."""


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

    A step is :meth:`choose`, :meth:`run`, ``estimator.update`` and :meth:`observe`.

    Args:
        num_routes: N.
        slots: S.
        settings: statistic, K, F and γ of SIC.
        reselection: M, or 0 for actions without a re-select bit.
        coverage: E, share of MuSIC's choices that a selection covers.
        allow_idle: whether an empty action runs nothing, instead of the cheapest technique.
        threads: of the estimator.

    Attributes:
        state: what is remembered of the routes.
        estimator: turns the rows that ran into places.
        routes: (N,) what each drives on, None before its first episode.
        drives: (N,) the rows of a live route, None for a bank.
        room: sizes that the arrays have room for.
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
        self.num_routes = num_routes
        self.slots = slots
        self.settings = settings
        self.coverage = coverage
        self.allow_idle = allow_idle
        self.routes: list[Route | None] = [None] * num_routes
        self.drives: list[LiveRows | None] = [None] * num_routes
        self.is_live = False  # whether there is any live route
        self._broken = np.zeros(num_routes, np.bool_)  # (N,) cut short by an error
        self._out = Outcome(OutcomeShape(num_routes, slots, reselection))  # of the last step
        sizes = {"routes": num_routes, "slots": slots, "block": reselection, "frames": 1}
        self.state = Batch(sizes, block=reselection)
        self._actions = np.zeros((num_routes, self.action_size), np.bool_)
        self.estimator = make_estimator(settings, block=reselection, threads=threads)
        self.room = {"references": 1, "frames": 1, "candidates": 1}
        self._allocate()

    @property
    def block(self) -> int:
        """M of the re-selection, 0 without."""
        return self.state.block

    @property
    def action_size(self) -> int:
        """S, and one more for the re-select bit."""
        return self.slots + (self.block > 0)

    # --- memory ---------------------------------------------------------------------------------

    def _allocate(self) -> None:
        """Make room, keeping what is remembered."""
        sizes = {**self.state.sizes, **self.room}
        self.state = self.state.grown(sizes)
        self.estimator.allocate(self.state, sizes)
        self._link()

    def _link(self) -> None:
        """Write the words that kernels read; to be done again when an array is replaced."""
        step = StepTable(
            {},
            batch=self.state,
            out=self._out,
            coverage=self.coverage,
            allow_idle=self.allow_idle,
            actions=self._actions,
        )
        self._words = step.write()
        self._address: int = self._words.ctypes.data

    def _make_room(self, references: int, frames: int) -> None:
        """Grow the arrays for a route of that size."""
        candidates = min(self.settings.candidates, references)
        wanted = {"references": references, "frames": frames, "candidates": candidates}
        room = {name: max(size, self.room[name]) for name, size in wanted.items()}
        if room != self.room:
            self.room = room
            self._allocate()

    def _remember_more(self) -> None:
        """Make room for frames: let the oldest half go if nothing comes back to it, or double.

        Nothing comes back further than a row is on the map; of several routes all frames are kept.
        """
        room = self.room["frames"]
        if self.num_routes > 1 or room < 2 * (self.room["references"] + self.block + 1):
            self._make_room(1, 2 * room)
            return
        for table in (self.state, self.estimator.state):
            table.let_go(room // 2)
        self.link()

    # --- episodes -------------------------------------------------------------------------------

    def begin(self, i: int, route: Route) -> None:
        """Start ``route`` as number ``i`` of the batch; nothing has run on it yet."""
        bank = route.bank
        if self.state.gone:  # the batch's only route
            self.state.gone = self.estimator.state.gone = 0
            self.link()
        self._make_room(bank.references, ROOM if route.frames == ENDLESS else route.frames)
        self.drives[i] = (
            None
            if isinstance(bank, ScoreBank)
            else bank.drive(route.start, self.settings, self.block)
        )
        if self.is_live or self.drives[i] is not None:
            self.is_live = any(drive is not None for drive in self.drives)
        self._broken[i] = False
        self.routes[i] = route
        self.state.ran[i].fill(0)
        record = self.state.routes[i : i + 1]
        record[:] = np.zeros(1, RouteState.dtype)
        record["frame"] = -1
        record["frames"] = route.frames
        record["bank"] = route.index
        record["references"] = bank.references
        record["tolerance"] = bank.tolerance
        record["compute_weight"] = route.compute_weight
        record["prediction"] = -1
        record["technique"] = -1
        record["spent"] = -1.0
        present = route.columns >= 0
        record["total_seconds"] = bank.seconds[route.columns[present]].sum()
        slots = self.state.slots[i]
        slots[:] = np.zeros(self.slots, SlotState.dtype)
        slots["present"] = present
        slots["last_run"] = -1
        slots["seconds"][present] = bank.seconds[route.columns[present]]
        declare_costs(record, slots)
        self.estimator.begin(i, bank.references)
        self._point(i)

    def set_compute_weight(self, i: int, weight: float) -> None:
        """Set λ of a running episode: of rewards and observations from the next step on.

        Args:
            i: number of the route in the batch.
            weight: λ, at least 0.
        """
        route = self.routes[i]
        assert route is not None
        self.routes[i] = replace(route, compute_weight=weight)
        record = self.state.routes[i : i + 1]
        record["compute_weight"] = weight
        declare_costs(record, self.state.slots[i])

    def _point(self, i: int) -> None:
        """Write the addresses of a route's rows."""
        route = self.routes[i]
        if route is None:
            return
        bank, runs, drive = route.bank, self.state.runs[i], self.drives[i]
        runs[:] = np.zeros(self.slots, Run.dtype)
        if drive is not None:
            drive.point(runs, route.columns)
            return
        assert isinstance(bank, ScoreBank)
        runs["start"] = route.start
        columns = np.maximum(route.columns, 0)  # an empty slot's are never read
        bank.prepared(self.settings.candidates).point(runs, columns)

    # --- a step ---------------------------------------------------------------------------------

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
        self._out.memory.fill(0)
        bad_rows = observe_routes(self._address)
        if self.is_live:
            self._broken &= ~self.state.active
        out = self._out.copy()
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

    # --- copies ---------------------------------------------------------------------------------

    def repeated(self, copies: int) -> Episodes:
        """A batch in which every route stands ``copies`` times in a row, each as it is now.

        Raises:
            ValueError: for live routes: the future of a camera can't be had several times.
        """
        if self.is_live:
            raise ValueError("a live route cannot be copied; give score banks")
        twin = copy.copy(self)
        twin.num_routes = self.num_routes * copies
        twin.routes = [route for route in self.routes for _ in range(copies)]
        twin.drives = [None] * twin.num_routes
        twin._broken = np.repeat(self._broken, copies)
        twin._out = Outcome(OutcomeShape(twin.num_routes, self.slots, self.block))
        twin._actions = np.repeat(self._actions, copies, 0)
        twin.state = self.state.repeated(copies)
        twin.estimator = self.estimator.repeated(twin.state, copies)
        twin._link()
        return twin

    def __getstate__(self) -> dict[str, Any]:
        """All but the addresses, which are those of this copy's arrays."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_words", "_address")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and write the addresses of its own arrays and of its banks' rows."""
        self.__dict__.update(state)
        self.link()

    def link(self) -> None:
        """Write the addresses of all arrays and rows anew, after some were replaced."""
        self.estimator.link(self.state)
        self._link()
        for i in range(self.num_routes):
            self._point(i)

    def __deepcopy__(self, memo: dict[int, Any]) -> Episodes:
        twin = type(self).__new__(type(self))
        memo[id(self)] = twin
        twin.__setstate__({k: copy.deepcopy(v, memo) for k, v in self.__getstate__().items()})
        return twin
