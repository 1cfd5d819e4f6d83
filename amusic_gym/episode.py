"""Episodes: the batch of routes that the single and the vector environment share.

:class:`Episodes` owns the arrays, begins routes and steps them; the arithmetic is in
:mod:`amusic_gym.dynamics`. The single environment is a batch of one.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym import belief
from amusic_gym.bank import ScoreBank
from amusic_gym.belief import Minds
from amusic_gym.calibration import coefficients
from amusic_gym.dynamics import (
    RESULT,
    ROUTE,
    SLOT,
    SLOT_RESULT,
    Outcome,
    Rules,
    State,
    step_routes,
)
from amusic_gym.live import ENDLESS
from amusic_gym.observation import declare_costs, observation_size
from amusic_gym.rows import RUN
from amusic_gym.settings import COVERAGE, SICSettings
from amusic_gym.sic import SLACK, SUMS
from amusic_gym.sources import Recording

if TYPE_CHECKING:
    from amusic_gym.live_rows import LiveRows

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
    ) -> None:
        self.num_routes = num_routes
        self.slots = slots
        self.settings = settings
        self.routes: list[Route | None] = [None] * num_routes
        self.drives: list[LiveRows | None] = [None] * num_routes  # of the live routes
        self.indices: NDArray[np.int64] = np.full(num_routes, -1)  # (N,) of the routes' banks
        self._broken = np.zeros(num_routes, np.bool_)  # (N,) cut short by an error
        self.rules = Rules(
            history=settings.history,
            gamma=float(settings.gamma),
            evidence=settings.statistic == "evidence",
            belief=settings.statistic == "belief",
            block=reselection,
            coverage=coverage,
            allow_idle=allow_idle,
            calibration=coefficients(settings.statistic),
        )
        self.stepped = np.zeros(
            num_routes, np.bool_
        )  # (N,) routes that processed a frame in the last step
        self._room = (1, 1, 1)  # places, frames and candidates that there is room for
        self.state, self.minds = self._allocate(*self._room)

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
            prefix=np.zeros((n, s, frames + 1)),
            values=np.zeros((s, candidates)),
            scratch=np.zeros(max(s, candidates)),
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
        for name in ("routes", "slots", "runs", "marks", "sums", "ran", "prefix"):
            _keep(getattr(old, name), getattr(new, name))
        for name in ("minds", "witnesses", "belief", "hubs"):
            _keep(getattr(old_minds, name), getattr(minds, name))
        self.state, self.minds = new, minds

    def begin(self, i: int, route: Route) -> None:
        """Start ``route`` as number ``i`` of the batch; nothing has run on it yet."""
        bank = route.bank
        self._make_room(bank.references, ROOM if route.frames == ENDLESS else route.frames)
        self.drives[i] = (
            None
            if isinstance(bank, ScoreBank)
            else bank.drive(route.start, self.settings, self.rules.block)
        )
        self._broken[i] = False
        self.routes[i] = route
        self.indices[i] = route.index
        state = self.state
        for array in (state.sums[:, i], state.ran[i], state.prefix[i]):
            array.fill(0)
        record = state.routes[i : i + 1]
        record[:] = np.zeros(1, ROUTE)
        record["frame"] = -1
        record["frames"] = route.frames
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
        marks = state.marks[:, i]
        marks[:] = np.zeros(1, SUMS)
        marks["last"] = -1
        marks["origin"] = max(state.sums.shape[-1] - bank.references, 0)
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
        prepared = bank.prepared(self.settings.candidates)
        runs["start"] = route.start
        runs["references"] = bank.references
        runs["candidates"] = prepared.candidates
        for s, t in enumerate(route.columns):
            if t < 0:
                continue
            runs["scores"][s] = bank.stored[bank.index[t]].ctypes.data
            for field in ("mean", "scale", "top", "ready"):
                runs[field][s] = getattr(prepared, field)[t].ctypes.data

    def step(self, active: NDArray[np.bool_], actions: NDArray[np.bool_]) -> Outcome:
        """Process the next frame of the active routes; the others are shown as they are.

        A live route whose source has ended is shown as it is, too: :attr:`stepped` tells.

        Args:
            active: (N,) routes to step.
            actions: (N, S), or (N, S + 1) with the re-select bit last.

        Raises:
            ValueError: for a row with NaN or infinite scores, naming technique and frame; for
                what a live route cannot compute, or a step after such an error.
            FileNotFoundError: for a live route's image that is gone.
        """
        out = self._outcome()
        self.stepped = active
        live = [i for i, drive in enumerate(self.drives) if drive is not None and active[i]]
        if live:
            self._step_live(live, actions, out)
        elif self.rules.belief and active.any():
            self._look_back(actions)
            step_routes(self.state, self.rules, active, actions, True, False, out)
            self._hear()
            step_routes(self.state, self.rules, active, actions, False, True, out)
        else:
            step_routes(self.state, self.rules, active, actions, True, True, out)
        bad = out.routes["bad_row"]
        if bad.any():
            raise ValueError(self._bad_row(bad))
        return out

    def _step_live(self, live: Sequence[int], actions: NDArray[np.bool_], out: Outcome) -> None:
        """A step with live routes: let their techniques run between the plan and its processing."""
        if self._broken[self.stepped].any():
            raise ValueError("an error cut the last step short; call reset() before the next")
        self._look_ahead(live)
        self._broken |= self.stepped
        live = [i for i in live if self.stepped[i]]
        for i in live:
            self._run(i, self._missed(i) if self.rules.block and actions[i, -1] else [])
        self._look_back(actions)
        step_routes(self.state, self.rules, self.stepped, actions, True, False, out)
        for i in live:
            frame = int(self.state.routes[i]["frame"]) + 1
            self._run(i, [(s, frame) for s in np.flatnonzero(out.slots["ran"][i]).tolist()])
        self._hear()
        step_routes(self.state, self.rules, self.stepped, actions, False, True, out)
        self._broken &= ~self.stepped

    def _look_back(self, actions: NDArray[np.bool_]) -> None:
        """Let the belief go through the last block again where a selection is asked for."""
        if not self.rules.belief or not self.rules.block:
            return
        state = self.state
        frames = state.routes["frame"]
        live = np.array([drive is not None for drive in self.drives])
        state.late.fill(0)
        belief.look_back(
            self.minds,
            self.stepped & actions[:, -1] & (frames >= 0),
            self.stepped & live,
            state.routes,
            state.slots,
            self.rules.block,
            state.runs,
            state.ran,
            state.late,
            state.statistics,
            state.corrections,
        )

    def _hear(self) -> None:
        """Let the belief hear what runs on the next frame."""
        if self.rules.belief:
            state = self.state
            belief.hear_routes(self.minds, self.stepped, state.routes, state.runs, state.ran)

    def _look_ahead(self, live: Sequence[int]) -> None:
        """Read the images of the next frame; routes whose source has ended take no step."""
        self.stepped = self.stepped.copy()
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

    def _run(self, i: int, wanted: Sequence[tuple[int, int]]) -> None:
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
        nobody = np.zeros(self.num_routes, np.bool_)
        return self.step(nobody, np.zeros((self.num_routes, self.action_size), np.bool_))

    @property
    def action_size(self) -> int:
        """S, and one more for the re-select bit."""
        return self.slots + (self.rules.block > 0)

    def _bad_row(self, bad: NDArray[np.int64]) -> str:
        i = int(np.flatnonzero(bad)[0])
        route = self.routes[i]
        assert route is not None
        slot, frame = divmod(int(bad[i]) - 1, route.frames)
        technique = route.bank.techniques[route.columns[slot]]
        return (
            f"score bank {route.bank.name!r}: NaN or infinite score of technique {technique!r} at"
            f" frame {route.start + frame}; mend the scores and write the bank again"
        )

    def _outcome(self) -> Outcome:
        n, s = self.num_routes, self.slots
        return Outcome(
            routes=np.zeros(n, RESULT),
            slots=np.zeros((n, s), SLOT_RESULT),
            corrections=np.zeros((n, s, self.rules.block)),
            observation=np.zeros((n, observation_size(s)), np.float32),
        )

    def finished(self) -> NDArray[np.bool_]:
        """(N,) whether each route's last frame has been processed."""
        routes = self.state.routes
        ended: NDArray[np.bool_] = routes["frame"] + 1 >= routes["frames"]
        return ended

    def frames_seen(self) -> NDArray[np.int64]:
        """(N,) frames processed since each route began."""
        seen: NDArray[np.int64] = self.state.routes["frame"] + 1
        return seen

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and write the addresses of its own banks' rows."""
        self.__dict__.update(state)
        minds, witnesses = self.minds.minds[0], self.minds.witnesses[0]  # views again
        self.state = self.state._replace(minds=minds, witnesses=witnesses)
        for i in range(self.num_routes):
            self._point(i)

    def __deepcopy__(self, memo: dict[int, Any]) -> Episodes:
        twin = type(self).__new__(type(self))
        memo[id(self)] = twin
        twin.__setstate__({k: copy.deepcopy(v, memo) for k, v in self.__dict__.items()})
        return twin


def _keep(old: NDArray[Any], new: NDArray[Any]) -> None:
    """Copy an array into the corner of a larger one."""
    new[tuple(slice(0, size) for size in old.shape)] = old
