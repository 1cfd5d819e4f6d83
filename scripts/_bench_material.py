"""What all measurements of the bench share: the bank, the sizes and plain NumPy."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.rows import prepare
from amusic_gym.envs.episode import Episodes
from amusic_gym.envs.memory import Route
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic.state import LIVE, state_at
from amusic_gym.estimation.sic.sums import correct_frame, count_runs, push
from amusic_gym.kernels.compiling import compiled

PLAIN: dict[str, Any] = {"statistic": "evidence", "carry": False, "discount": False}
"""What the NumPy side computes, too."""

BYTES_PER_PLACE = 4 + 8 + 8  # of a row add: read a float32 score, read and write a float64 sum


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
    starts: int = 5  # processes per start-up time
    images: int = 64  # rendered street frames
    live_places: int = 1000  # of the map that is driven through
    live_frames: int = 100  # of that drive


QUICK = Sizes(
    *(4, 120, 20, 60, 80, 8), rounds=3, steps=5, ppo_rounds=1, ppo_steps=16, ppo_batch=32,
    starts=1, images=4, live_places=70, live_frames=3,
)  # fmt: skip


class Material:
    """The bank that everything runs on. Route i begins at query i, on rows of its own."""

    def __init__(self, sizes: Sizes) -> None:
        self.sizes = sizes
        queries = sizes.frames + sizes.routes
        rng = np.random.default_rng(0)
        scores = rng.standard_normal((sizes.techniques, queries, sizes.places), np.float32)
        truth = np.arange(queries) - sizes.routes
        truth[(truth < 0) | (truth >= sizes.places)] = -1
        seen = np.flatnonzero(truth >= 0)
        scores[:, seen, truth[seen]] += 2.0
        names = [f"technique {t}" for t in range(sizes.techniques)]
        seconds = 0.05 * 2.0 ** np.arange(sizes.techniques)
        self.bank = ScoreBank(scores, names, seconds, tolerance=5, ground_truth=truth, name="bench")

    def arguments(self, **other: Any) -> dict[str, Any]:
        """Arguments of every environment measured: `PLAIN`, but for others that are given."""
        settings = {"candidates": self.sizes.candidates, "history": self.sizes.history}
        return {"bank": self.bank, **settings, **PLAIN, **other}


class Corrections:
    """SIC on N routes up to the last frame, to be repeated over the last frames of them."""

    def __init__(self, material: Material) -> None:
        sizes, bank = material.sizes, material.bank
        settings = SICSettings(candidates=sizes.candidates, history=sizes.history, **PLAIN)
        self._owner = Episodes(sizes.routes, 1, settings, reselection=0)
        for i in range(sizes.routes):
            self._owner.begin(i, Route(bank, i, sizes.frames, np.array([0]), 1.0, 0))
        state: Any = self._owner.estimator.state
        self.sums, self.marks = state.sums[0, :, 0], state.marks[0, :, 0]
        self.runs = self._owner.state.runs[:, 0]
        self._words = state.write()
        self._address = int(self._words.ctypes.data)
        self.places = np.zeros(sizes.routes, np.int64)
        self.statistics = np.zeros(sizes.routes)
        self.frames = range(sizes.frames - sizes.steps, sizes.frames)  # timed
        for query in range(bank.queries):
            prepare(self.runs[0], query)
        self.forward(range(self.frames.start))
        self._kept = (self.sums.copy(), self.marks.copy())

    def rewind(self) -> None:
        """Go back to before the timed frames."""
        self.sums[:], self.marks[:] = self._kept

    def forward(self, frames: range | None = None) -> None:
        """One correction on every route and frame; None: those that are timed."""
        for frame in frames or self.frames:
            correct_routes(self._address, frame, self.places, self.statistics)

    def add_rows(self) -> None:
        """Only the accumulator's part of it."""
        for frame in self.frames:
            push_routes(self._address, frame)


@compiled
def correct_routes(
    address: int, frame: int, places: NDArray[np.int64], statistics: NDArray[np.float64]
) -> None:
    """The package's SIC on each of N routes at ``frame``."""
    state = state_at(address)
    for i in range(places.size):
        state.batch.ran[i, 0, frame] = True
        count_runs(state, i, 0, frame, frame + 1)
        winner = correct_frame(state, i, 0, frame, -1, -1)
        places[i] = state.candidates[0, winner]
        statistics[i] = state.values[0, winner]


@compiled
def push_routes(address: int, frame: int) -> None:
    """The package's row add on each of N routes at ``frame``."""
    state = state_at(address)
    for i in range(state.batch.active.size):
        push(state, LIVE, i, 0, frame)


@compiled
def stream(rows: Any, windows: Any) -> None:
    """Add float32 rows (N, R) to float64 windows (N, R): the least that any accumulator does."""
    for i in range(rows.shape[0]):
        row, window = rows[i], windows[i]
        for place in range(row.size):
            window[place] += row[place]


def gather(
    z: NDArray[np.float64], frame: int, top: NDArray[np.int64], history: int
) -> NDArray[np.float64]:
    """SIC's statistics (K,) at a frame: gather all K×F z-scores of the diagonals and sum them.

    `z` (Q, R) are standardised scores of a technique that ran on every frame, `top` (K,) the
    candidates. Indices into the flattened rows gather faster than pairs of indices.
    """
    ages = np.arange(min(history, frame) + 1)
    on_map = top[:, None] >= ages  # (K, F)
    flat = (frame * z.shape[1] + top)[:, None] - ages * (z.shape[1] + 1)
    terms = np.where(on_map, z.ravel().take(flat, mode="wrap"), 0.0)
    statistics: NDArray[np.float64] = terms.sum(axis=1) / np.sqrt(on_map.sum(axis=1))
    return statistics
