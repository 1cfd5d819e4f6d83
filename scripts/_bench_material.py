"""The bank, the checks and the sizes that all measurements of the bench share."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import _bench_reference as reference
import numpy as np
from _bench_kernels import correct_routes

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.rows import prepare
from amusic_gym.envs.episode import Episodes, Route
from amusic_gym.estimation.calibration import coefficients
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic import CARRIED

TOLERANCE = 5

PLAIN: dict[str, Any] = {"statistic": "evidence", "carry": False, "discount": False}
"""What the NumPy side computes, too."""

DEFAULT: dict[str, Any] = {"statistic": SICSettings.statistic, "carry": None, "discount": None}
"""What the environment takes by itself."""


class Sizes(NamedTuple):
    """What is measured."""

    techniques: int = 4  # T
    places: int = 1000  # R
    candidates: int = 50  # K
    history: int = 1000  # F
    frames: int = 1000  # of every route; the timed ones end with the last
    routes: int = 64  # N
    rounds: int = 15
    steps: int = 20  # of each side in one round
    ppo_rounds: int = 3
    ppo_steps: int = 64  # of every route in one rollout
    ppo_batch: int = 512

    @property
    def timed(self) -> int:
        """Frames that the rounds and the warm-up take."""
        return (self.rounds + 1) * self.steps


QUICK = Sizes(
    places=120,
    candidates=20,
    history=60,
    frames=80,
    routes=8,
    rounds=3,
    steps=5,
    ppo_rounds=1,
    ppo_steps=16,
    ppo_batch=32,
)


class Material:
    """The bank that everything runs on, and what NumPy makes of it.

    Route i begins at query i, so that the routes of a batch read different rows.
    """

    SETTLED = 20  # frames with a true place after which it must be found

    def __init__(self, sizes: Sizes, seed: int = 0) -> None:
        """Draw the scores and standardise and rank them in NumPy."""
        self.sizes = sizes
        queries = sizes.frames + sizes.routes
        rng = np.random.default_rng(seed)
        scores = rng.standard_normal((sizes.techniques, queries, sizes.places), np.float32)
        truth = np.arange(queries) - sizes.routes
        truth[(truth < 0) | (truth >= sizes.places)] = -1
        seen = np.flatnonzero(truth >= 0)
        scores[:, seen, truth[seen]] += 2.0
        names = [f"technique {t}" for t in range(sizes.techniques)]
        seconds = 0.05 * 2.0 ** np.arange(sizes.techniques)
        self.bank = ScoreBank(
            scores, names, seconds, tolerance=TOLERANCE, ground_truth=truth, name="bench"
        )
        self.starts = np.arange(sizes.routes)
        self.z = [reference.standardised(rows) for rows in self.bank.scores]
        self.top = [reference.ranked(rows, sizes.candidates) for rows in self.bank.scores]

    def env_arguments(self, **other: Any) -> dict[str, Any]:
        """Arguments of every environment measured: `PLAIN`, but for others that are given."""
        settings = {"candidates": self.sizes.candidates, "history": self.sizes.history}
        return {"bank": self.bank, **settings, **PLAIN, **other}

    @cached_property
    def everything(self) -> Any:
        """(N, T) actions that run all techniques."""
        return np.ones((self.sizes.routes, self.sizes.techniques), np.int8)

    def check_frame(self, frame: int, rewards: Any, infos: dict[str, Any] | None) -> None:
        """Compare a frame of routes 0 … N−1 with NumPy; compute costs 1 where everything ran."""
        until = np.arange(frame + 1)
        for i, reward in enumerate(np.atleast_1d(rewards)):
            places, techniques = (column[: frame + 1] for column in self.predicted[i])
            similarities = np.array(
                [self.z[t][i + q, p] for q, t, p in zip(until, techniques, places, strict=True)]
            )
            want = reference.expected(
                self.z,
                self.top,
                i,
                frame,
                history=self.sizes.history,
                tolerance=TOLERANCE,
                track=reference.track_of(places),
                recent=reference.recent_of(similarities),
                calibration=coefficients("evidence")[:8],
            )
            same(f"reward of route {i} at frame {frame}", reward, want.p_correct - 1.0, 1e-5)
            for name in ("prediction", "technique", "confidence") if infos else ():
                got = np.atleast_1d(infos[name])[i]  # type: ignore[index]
                same(f"{name} of route {i} at frame {frame}", got, getattr(want, name), 1e-9)

    @cached_property
    def predicted(self) -> list[Any]:
        """Places and techniques, (Q,) each, on every route where everything runs."""
        sizes, sums = self.sizes, [reference.summed(rows) for rows in self.z]
        known = (sums, self.top)
        return [
            reference.predicted(*known, start, sizes.frames, sizes.history)
            for start in range(sizes.routes)
        ]

    @cached_property
    def halves(self) -> Any:
        """(Q, N, T) actions that run a technique on every other frame, at random."""
        sizes, rng = self.sizes, np.random.default_rng(1)
        return rng.integers(0, 2, (sizes.frames, sizes.routes, sizes.techniques), np.int8)

    def check_statistics(self, frame: int, ran: Any, infos: dict[str, Any]) -> None:
        """Compare the statistics of what ran on a frame with NumPy.

        Args:
            frame: the frame, the last one of those in ``ran``.
            ran: (frame + 1, N, T) bool, what ran until then.
            infos: of the frame.
        """
        history = self.sizes.history
        for i, t in np.argwhere(ran[frame]):
            z, top = self.z[t][i:], self.top[t][i + frame]
            want = reference.gather_runs(z, ran[:, i, t], frame, top, history).max()
            what = f"statistic of route {i}, technique {t} at frame {frame}"
            same(what, infos["statistic"][i, t], float(want), 1e-9)

    def check_places(self, frame: int, infos: dict[str, Any]) -> None:
        """Compare a frame's predictions with the true places, where there are any.

        For a statistic that sees more than K candidates: the true place, two deviations above the
        noise in every technique, is sometimes not among them.
        """
        for i, place in enumerate(np.atleast_1d(infos["prediction"])):
            true = i + frame - self.sizes.routes
            if self.SETTLED <= true < self.sizes.places:
                off = float(abs(place - true))
                same(f"error of route {i} at frame {frame}", min(off, TOLERANCE), off, 0.0)

    def checked_frames(self) -> set[int]:
        """Frames that are compared: the first ones, some inside and the last.

        On frame N, route i has had a true place for i frames: p̂ is neither 0 nor 1 on all routes.
        """
        return {0, 1, self.sizes.routes, self.sizes.frames // 2, self.sizes.frames - 1}


def same(what: str, got: float, want: float, relative: float) -> None:
    """Refuse to time what is wrong.

    Raises:
        RuntimeError: if the two differ by more than ``relative``.
    """
    if not math.isclose(got, want, rel_tol=relative, abs_tol=relative):
        raise RuntimeError(f"{what} is {got}, but NumPy says {want}: nothing wrong is timed")


class Corrections:
    """SIC on N routes up to the last frame, to be repeated over the last frames of them."""

    def __init__(self, material: Material) -> None:
        """Go to where the timed frames begin."""
        sizes, bank = material.sizes, material.bank
        settings = SICSettings(candidates=sizes.candidates, history=sizes.history, **PLAIN)
        self._owner = Episodes(sizes.routes, 1, settings, reselection=0)
        for i in range(sizes.routes):
            route = Route(bank, i, sizes.frames, np.array([0]), 1.0, 0)
            self._owner.begin(i, route)
        self.state = state = self._owner.state
        self.sums, self.marks, self.runs = (
            state.sums[0, :, 0],
            state.marks[0, :, 0],
            state.runs[:, 0],
        )
        self.histories = (state.ran[:, 0], state.counts[:, 0], state.prefix[:, 0])
        self.values, self.factors = state.values[0], state.factors
        self.carried = np.full(CARRIED, -1)
        self.places = np.zeros(sizes.routes, np.int64)
        self.statistics = np.zeros(sizes.routes)
        self.history, self._correct = sizes.history, correct_routes
        self.frames = range(sizes.frames - sizes.steps, sizes.frames)  # timed
        for query in range(bank.queries):
            prepare(self.runs[0], query)
        for frame in range(self.frames.start):
            self.at(frame)
        self._kept = (self.sums.copy(), self.marks.copy())

    def at(self, frame: int) -> None:
        """One correction on every route."""
        self._correct(
            *(self.sums, self.marks, self.runs, *self.histories, self.values, self.carried),
            *(self.factors, frame, self.history, self.places, self.statistics),
        )

    def rewind(self) -> None:
        """Go back to before the timed frames."""
        self.sums[:], self.marks[:] = self._kept

    def forward(self) -> None:
        """One correction on every route and timed frame."""
        for frame in self.frames:
            self.at(frame)
