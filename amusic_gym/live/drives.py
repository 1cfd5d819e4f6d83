"""A policy along a live route, frame by frame: the one loop under `navigate` and `Localiser`."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.live.limits import Keeper
from amusic_gym.policies.protocol import Correction, Localiser, Policy, Rows, Selector, highest_z
from amusic_gym.techniques.protocol import Image
from amusic_gym.utils.states import Arrays, put_back, taken

if TYPE_CHECKING:
    from amusic_gym.envs.live_rows import LiveRows


@dataclass(frozen=True, eq=False)
class FrameResult:
    """One frame of a drive: what ran, where the robot is, and how long it took."""

    frame: int  # number of the frame, from 0
    image: Image = field(repr=False)  # the query image
    prediction: int  # place, -1 before the first
    confidence: float  # higher = surer
    # z-score of the place in this frame's row of the technique that MuSIC trusted; of a localiser,
    # the largest in the rows it asked for; 0 where nothing ran
    similarity: float
    p_correct: float | None  # SIC-estimated correctness; None where the policy gives none
    technique: int  # the one that MuSIC trusted, -1: none
    # (T,) bool, on the frame itself; not those that raised or are left out for it
    ran: NDArray[np.bool_]
    late_runs: NDArray[np.int64]  # (T,) after-the-fact runs before it
    selection: bool  # whether a selection was done before it
    # λ that the policy chose with; None where it gives the places itself
    compute_weight: float | None
    # (T,) wall time of the runs, after-the-fact ones included
    run_milliseconds: NDArray[np.float64]
    read_milliseconds: float  # wall time until the image was there: disk, decoder or camera
    milliseconds: float  # wall time of all the rest: the policy, the runs and the localisation
    techniques: tuple[str, ...]  # T names

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the techniques that ran on the frame."""
        return tuple(n for n, on in zip(self.techniques, self.ran, strict=True) if on)


RETRY = 100  # frames for which a technique that raised is left out


def drive_along(
    policy: Policy,
    route: LiveRoute,
    how: Correction,
    *,
    compute_weight: float | None = None,
    keeper: Keeper | None = None,
) -> _SelectorDrive | _LocaliserDrive:
    """A drive that is about to take its first frame; see `amusic_gym.live.navigation.navigate`."""
    if isinstance(policy, Selector):
        weight = 1.0 if compute_weight is None else compute_weight
        return _SelectorDrive(policy, route, how, weight, keeper)
    return _LocaliserDrive(policy, route)


class _SelectorDrive:
    """The policy chooses techniques, and a batch of one route does the rest."""

    def __init__(
        self,
        policy: Selector,
        route: LiveRoute,
        how: Correction,
        compute_weight: float,
        keeper: Keeper | None,
    ) -> None:
        from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

        needs = policy.needs
        self._policy = policy
        self._techniques = len(route.techniques)
        self._weight = compute_weight
        self._keeper = keeper
        self._env = TechniqueSelectionVectorEnv(
            1,
            route,
            slots=self._techniques,
            reselection=needs.reselection,
            coverage=needs.coverage,
            allow_idle=needs.allow_idle,
            **how._asdict(),
            **needs.extra,
        )
        self.begin()

    def begin(self) -> None:
        """Forget everything; the next frame is the source's first."""
        weight = self._weight if self._keeper is None else self._keeper.weight
        options = {"start": 0, "compute_weight": weight}
        self._observation, self._info = self._env.reset(options=options)
        self._policy.reset(np.ones(1, np.bool_))
        self._rows.retry = RETRY
        self._ended = False

    def step(self, *, everything: bool = False) -> FrameResult | None:
        """Take the next frame; None where the source has ended.

        With ``everything`` all techniques run on it, whatever the policy wants.
        """
        if self._ended:
            return None
        drive = self._rows
        begin, last = time.perf_counter(), drive.frame
        action = self._policy.act(self._observation, self._info)
        weight = float(self._info["compute_weight"][0])
        action = np.array(action, np.bool_)
        if everything:
            action[:, : self._techniques] = True
        if self._keeper is not None:
            action[0] = self._keeper.choose(action[0], self._observation)
        self._leave_out(action[0, : self._techniques])
        self._observation, _, terminated, truncated, self._info = self._env.step(action)
        self._ended = bool(terminated[0] or truncated[0])
        if drive.frame == last:
            return None
        elapsed = 1000.0 * (time.perf_counter() - begin)
        told = _told(self._info, self._techniques)
        seen = _seen(drive, elapsed, compute_weight=weight, **told)
        if self._keeper is not None:
            self._keeper.note(seen)
            self._env.task.episodes.set_compute_weight(0, self._keeper.weight)
        return seen

    def _leave_out(self, wanted: NDArray[np.bool_]) -> None:
        """Take techniques that raised lately out of the action; the cheapest other if all did."""
        usable = self._rows.out_until <= self._rows.frame + 1
        if wanted.any() and not (wanted & usable).any():
            seconds = self._rows.route.seconds
            wanted[int(np.where(usable, seconds, np.inf).argmin())] = True
        wanted &= usable

    @property
    def _rows(self) -> LiveRows:
        drive = self._env.task.episodes.drives[0]
        assert drive is not None
        return drive

    def save(self, arrays: Arrays) -> Any:
        """What is remembered, see :func:`amusic_gym.utils.states.taken`."""
        last = {"observation": self._observation, "info": self._info, "ended": self._ended}
        return taken({**self._parts(), "last": last}, arrays, _KEPT)

    def restore(self, saved: Any, arrays: Arrays) -> None:
        """Go on from what was saved of a drive of the same policy, map and settings."""
        found = put_back({**self._parts(), "last": {}}, saved, arrays, "drive")
        self._observation, self._info, self._ended = found["last"].values()
        episodes = self._env.task.episodes
        episodes.room = found["room"]
        episodes.link()

    def _parts(self) -> dict[str, Any]:
        """What changes on the way."""
        episodes = self._env.task.episodes
        return {
            "batch": episodes.state,
            "estimator": episodes.estimator.state,
            "rows": self._rows,
            "policy": self._policy,
            "room": episodes.room,
            "keeper": self._keeper,
        }


_KEPT = frozenset({"route", "batch", "_turn", "_policy"})  # attributes that are the new drive's own


def _told(info: dict[str, Any], techniques: int) -> dict[str, Any]:
    """What the infos of a batch of one say of the frame."""
    selection = info.get("selection")
    none = np.zeros(techniques, np.int64)
    return {
        "prediction": int(info["prediction"][0]),
        "confidence": float(info["confidence"][0]),
        "similarity": float(info["similarity"][0]),
        "p_correct": float(info["p_correct"][0]),
        "technique": int(info["technique"][0]),
        "ran": info["ran"][0],
        "late_runs": none if selection is None else selection["late_runs"][0],
        "selection": selection is not None and bool(selection["happened"][0]),
    }


class _LocaliserDrive:
    """The policy gives the places itself; otherwise as `_SelectorDrive`."""

    def __init__(self, policy: Localiser, route: LiveRoute) -> None:
        self._policy, self._route = policy, route
        self.begin()

    def begin(self) -> None:
        self._rows = self._route.drive(0, SICSettings(), 0)
        self._rows.retry = RETRY
        self._policy.reset(self._route.references, len(self._route.techniques))
        self._frame = 0

    def step(self, *, everything: bool = False) -> FrameResult | None:
        drive, techniques = self._rows, len(self._route.techniques)
        begin = time.perf_counter()
        if drive.frames is not None and self._frame >= drive.frames:
            return None
        if not drive.advance(self._frame):
            return None
        ran = np.zeros(techniques, np.bool_)
        rows: Rows = {}

        def run(technique: int) -> NDArray[np.float32]:
            ran[technique] = True
            rows[technique] = row = drive.run(technique, drive.frame)
            return row.copy()  # its memory will hold another frame

        for technique in range(techniques if everything else 0):
            run(technique)
        place, confidence = self._policy.locate(self._frame, run)
        self._frame += 1
        return _seen(
            drive,
            1000.0 * (time.perf_counter() - begin),
            prediction=place,
            confidence=confidence,
            similarity=highest_z(rows.values(), place),
            p_correct=None,
            technique=-1,
            ran=ran,
            late_runs=np.zeros(techniques, np.int64),
            selection=False,
            compute_weight=None,
        )

    def save(self, arrays: Arrays) -> Any:
        parts = {"rows": self._rows, "policy": self._policy, "frame": self._frame}
        return taken(parts, arrays, _KEPT)

    def restore(self, saved: Any, arrays: Arrays) -> None:
        parts = {"rows": self._rows, "policy": self._policy, "frame": 0}
        self._frame = put_back(parts, saved, arrays, "drive")["frame"]


def _seen(drive: LiveRows, elapsed: float, **told: Any) -> FrameResult:
    """A frame with what the drive knows of it; ``elapsed`` milliseconds in all."""
    told["ran"] = told["ran"] & drive.usable
    return FrameResult(
        frame=drive.frame,
        image=drive.image(),
        run_milliseconds=drive.milliseconds + drive.late_milliseconds,
        read_milliseconds=drive.read_milliseconds,
        milliseconds=elapsed - drive.read_milliseconds,
        techniques=drive.route.techniques,
        **told,
    )
