"""Memory of a batch of episodes: it begins routes, grows with them, and is copied."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.rows import Run
from amusic_gym.envs.live_route import ENDLESS
from amusic_gym.envs.observation import declare_costs, observation_size
from amusic_gym.envs.outcome import OutcomeTable
from amusic_gym.envs.sources import Recording
from amusic_gym.estimation.batch import Batch, RouteState, SlotState
from amusic_gym.estimation.estimator import make_estimator
from amusic_gym.estimation.settings import COVERAGE, SICSettings
from amusic_gym.kernels.tables import Table, array

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


class StepTable(Table):
    """What the kernels of a step read and write.

    Arrays: ``actions`` (N, A), A = S, or S + 1 with the re-select bit last.
    """

    batch: Batch
    out: OutcomeTable
    coverage: float  # E
    allow_idle: bool
    actions: NDArray[np.bool_] = array(np.bool_, "routes", "actions")


class EpisodeMemory:
    """A batch of N routes with S technique slots each.

    Args:
        num_routes: N.
        slots: S.
        settings: statistic, K, F and γ of SIC.
        reselection: M, or 0 for actions without a re-select bit.
        coverage: E, share of MuSIC's choices that a selection covers.
        allow_idle: whether an empty action runs nothing, instead of the cheapest technique.
        threads: of the estimator.

    Attributes:
        block: M, 0 without re-selection.
        action_size: S, and one more for the re-select bit.
        state: what is remembered of the routes.
        estimator: turns the rows that ran into places.
        routes: (N,) what each drives on, None before its first episode.
        drives: (N,) the rows of a live route, None for a bank.
        is_live: whether there is any live route.
        room: sizes that the arrays have room for.
        shown: memory that kernels write an outcome to, which lies in it by ``layout``.
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
        self.block = reselection
        self.action_size = slots + (reselection > 0)
        self.settings = settings
        self.coverage = coverage
        self.allow_idle = allow_idle
        self.routes: list[Route | None] = [None] * num_routes
        self.drives: list[LiveRows | None] = [None] * num_routes
        self.is_live = False
        self._broken = np.zeros(num_routes, np.bool_)  # (N,) cut short by an error
        sizes = {"routes": num_routes, "slots": slots, "block": reselection, "frames": 1}
        self.state = Batch(sizes, block=reselection)
        self._actions = np.zeros((num_routes, self.action_size), np.bool_)
        self.estimator = make_estimator(settings, block=reselection, threads=threads)
        self.room = {"references": 1, "frames": 1, "candidates": 1}
        self._allocate_outcome()
        self._allocate()

    def _allocate_outcome(self) -> None:
        """Make room for an outcome."""
        sizes = {"routes": self.num_routes, "slots": self.slots, "block": self.block}
        self.layout = OutcomeTable.one_record({**sizes, "entries": observation_size(self.slots)})
        self.shown = np.zeros(self.layout.itemsize, np.uint8)

    # --- memory ---------------------------------------------------------------------------------

    def _allocate(self) -> None:
        """Make room, keeping what is remembered."""
        sizes = {**self.state.sizes, **self.room}
        self.state = self.state.grown(sizes)
        self.estimator.allocate(self.state, sizes)
        self._link()

    def _link(self) -> None:
        """Write the words that kernels read; to be done again when an array is replaced."""
        record: Any = np.ndarray((), self.layout, self.shown)
        step = StepTable(
            {},
            batch=self.state,
            out=OutcomeTable({}, **{name: record[name] for name in OutcomeTable.columns}),
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

    # --- copies ---------------------------------------------------------------------------------

    def repeated(self, copies: int) -> Self:
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
        twin._allocate_outcome()
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

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        twin = type(self).__new__(type(self))
        memo[id(self)] = twin
        twin.__setstate__({k: copy.deepcopy(v, memo) for k, v in self.__getstate__().items()})
        return twin
