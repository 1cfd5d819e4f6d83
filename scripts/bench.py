"""Measure the speed as ratios, both sides in one run; print a table and write one JSON object.

    python scripts/bench.py --out FILE.json

Every timed path is checked first against NumPy code of another kind (_bench_reference.py). The
sides take turns, after one warm-up, on one thread; each figure is a median.

| ratio | of what | better |
|---|---|---|
| sic_vs_numpy | one SIC correction: time of the K×F gather in NumPy / ours | more |
| vector_env_vs_cartpole_vector | steps/s of the vector env / Gymnasium's CartPole vector env | more |
| single_env_vs_cartpole | steps/s of the unwrapped single env / unwrapped CartPole | more |
| ppo_vs_constant_env | wall time of PPO on the env / on one that returns constants | near 1 |
| sic_share_of_limit | bytes/s of the accumulator's row add / of a plain stream of that kind | near 1 |
"""

from __future__ import annotations

import argparse
import inspect
import json
import math
from collections.abc import Callable
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

from _timing import Medians, Side, interleave, one_thread, readable

one_thread()

import _bench_reference as reference  # noqa: E402  (NumPy and torch read the line above)
import gymnasium as gym  # noqa: E402
import numpy as np  # noqa: E402
from _cli import Parser, run  # noqa: E402

from amusic_gym.bank import ScoreBank  # noqa: E402
from amusic_gym.calibration import coefficients  # noqa: E402
from amusic_gym.env import TechniqueSelectionEnv  # noqa: E402
from amusic_gym.vector_env import TechniqueSelectionVectorEnv  # noqa: E402

TOLERANCE = 5
BYTES_PER_PLACE = 4 + 8 + 8  # read a float32 score, read and write a float64 sum


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
    ppo_batch=64,
)


class Measured(NamedTuple):
    """A line of the table."""

    ratio: float
    medians: Medians
    unit: str
    ours: str
    theirs: str


class Material:
    """The bank that everything runs on, and what NumPy makes of it.

    Route i begins at query i, so that the routes of a batch read different rows.
    """

    def __init__(self, sizes: Sizes, seed: int = 0) -> None:
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

    @property
    def env_arguments(self) -> dict[str, Any]:
        """Arguments of every environment measured."""
        settings = {"candidates": self.sizes.candidates, "history": self.sizes.history}
        return {"bank": self.bank, "statistic": "evidence", **settings}

    @cached_property
    def everything(self) -> Any:
        """(N, T) actions that run all techniques."""
        return np.ones((self.sizes.routes, self.sizes.techniques), np.int8)

    def check_frame(self, frame: int, rewards: Any, infos: dict[str, Any] | None) -> None:
        """Compare a frame of routes 0 … N−1 with NumPy; compute costs 1 where everything ran."""
        for i, reward in enumerate(np.atleast_1d(rewards)):
            want = reference.expected(
                self.z,
                self.top,
                i,
                frame,
                history=self.sizes.history,
                tolerance=TOLERANCE,
                calibration=coefficients("evidence")[:3],
            )
            _same(f"reward of route {i} at frame {frame}", reward, want.p_correct - 1.0, 1e-5)
            for name in ("prediction", "technique", "confidence") if infos else ():
                got = np.atleast_1d(infos[name])[i]  # type: ignore[index]
                _same(f"{name} of route {i} at frame {frame}", got, getattr(want, name), 1e-9)

    def checked_frames(self) -> set[int]:
        """Frames that are compared: the first ones, one inside and the last."""
        return {0, 1, self.sizes.frames // 2, self.sizes.frames - 1}


def _same(what: str, got: float, want: float, relative: float) -> None:
    if not math.isclose(got, want, rel_tol=relative, abs_tol=relative):
        raise RuntimeError(f"{what} is {got}, but NumPy says {want}: nothing wrong is timed")


class Corrections:
    """SIC on N routes up to the last frame, to be repeated over the last frames of them."""

    def __init__(self, material: Material) -> None:
        from _bench_kernels import correct_routes

        from amusic_gym.episode import Episodes, Route
        from amusic_gym.settings import SICSettings
        from amusic_gym.sic import prepare

        sizes, bank = material.sizes, material.bank
        settings = SICSettings("evidence", sizes.candidates, sizes.history)
        self._owner = Episodes(sizes.routes, 1, settings, reselection=0)
        for i in range(sizes.routes):
            route = Route(bank, i, sizes.frames, np.array([0]), 1.0, 0)
            self._owner.begin(i, route)
        state = self._owner.state
        self.sums, self.marks, self.runs = (
            state.sums[0, :, 0],
            state.marks[0, :, 0],
            state.runs[:, 0],
        )
        self.histories = (state.ran[:, 0], state.weights[:, 0], state.squares[:, 0])
        self.values = state.values[0]
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
            *(self.sums, self.marks, self.runs, *self.histories, self.values),
            *(frame, self.history, self.places, self.statistics),
        )

    def rewind(self) -> None:
        """Go back to before the timed frames."""
        self.sums[:], self.marks[:] = self._kept

    def forward(self) -> None:
        """One correction on every route and timed frame."""
        for frame in self.frames:
            self.at(frame)


def measure_sic(material: Material) -> Measured:
    """One SIC correction at the last frame against the K×F gather in NumPy."""
    sizes, ours = material.sizes, Corrections(material)
    frame, z, top = sizes.frames - 1, material.z[0], material.top[0]

    def gather_all() -> list[tuple[int, float]]:
        found = []
        for i in range(sizes.routes):
            values = reference.gather(z[i:], frame, top[i + frame], sizes.history)
            best = int(np.argmax(values))
            found.append((int(top[i + frame][best]), float(values[best])))
        return found

    ours.forward()
    for i, (place, statistic) in enumerate(gather_all()):
        _same(f"place of route {i}", ours.places[i], place, 0.0)
        _same(f"statistic of route {i}", ours.statistics[i], statistic, 1e-9)
    medians = interleave(
        Side("compiled", ours.forward, sizes.routes * sizes.steps, ours.rewind),
        Side("NumPy", gather_all, sizes.routes),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "correction", "compiled", "NumPy gather")


def measure_limit(material: Material) -> Measured:
    """The accumulator's row add against a plain stream over as many bytes."""
    from _bench_kernels import push_routes, stream

    sizes, ours = material.sizes, Corrections(material)
    frames = ours.frames
    windows = np.zeros((sizes.routes, sizes.places))
    rows = material.bank.scores[0]

    def push_all() -> None:
        for frame in frames:
            push_routes(ours.sums, ours.marks, ours.runs, ours.histories[0], frame, ours.history)

    def stream_all() -> None:
        for frame in frames:
            stream(rows[frame : frame + sizes.routes], windows)

    _check_sums(material, ours, push_all)
    stream_all()
    summed = sum(rows[f : f + sizes.routes].astype(np.float64) for f in frames)
    if not np.allclose(windows, summed, rtol=1e-12, atol=1e-12):
        raise RuntimeError("the stream's sums are wrong: nothing wrong is timed")
    places = sizes.routes * sizes.places * len(frames)
    medians = interleave(
        Side("row add", push_all, places * BYTES_PER_PLACE, ours.rewind),
        Side("stream", stream_all, places * BYTES_PER_PLACE),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "byte", "SIC's row add", "plain stream")


def _check_sums(material: Material, ours: Corrections, push_all: Callable[[], None]) -> None:
    """Compare the sums of route 0 after the timed frames with those of its diagonals."""
    last, z = material.sizes.frames - 1, material.z[0]
    ours.histories[0][:, ours.frames.start :] = 1
    push_all()
    window = ours.sums[0, ours.marks[0]["origin"] - last :]
    for place in range(0, material.sizes.places, 37):
        ages = np.arange(min(material.sizes.history, last, place) + 1)
        want = float(z[last - ages, place - ages].sum())
        _same(f"sum of place {place}", float(window[place]), want, 1e-8)


def _stepper(env: Any, action: Any, steps: int) -> Callable[[], None]:
    def advance() -> None:
        for _ in range(steps):
            env.step(action)

    return advance


def _play_checked(env: Any, material: Material, action: Any, options: dict[str, Any]) -> None:
    """Play a whole route and compare; then begin again and go on to where timing starts."""
    env.reset(seed=0, options=options)
    for frame in range(material.sizes.frames):
        _, rewards, _, _, infos = env.step(action)
        if frame in material.checked_frames():
            material.check_frame(frame, rewards, infos)
    env.reset(seed=0, options=options)
    _stepper(env, action, material.sizes.frames - material.sizes.timed)()


def measure_vector_env(material: Material) -> Measured:
    """The vector env, all techniques on all routes, against Gymnasium's native CartPole."""
    sizes = material.sizes
    env = TechniqueSelectionVectorEnv(sizes.routes, **material.env_arguments)
    _play_checked(env, material, material.everything, {"start": material.starts})
    cartpole = gym.make_vec(
        "CartPole-v1", num_envs=sizes.routes, vectorization_mode="vector_entry_point"
    )
    cartpole.reset(seed=0)
    pushes = cycle(np.random.default_rng(0).integers(0, 2, (97, sizes.routes)))

    def balance() -> None:
        for _ in range(sizes.steps):
            cartpole.step(next(pushes))

    units = sizes.steps * sizes.routes
    medians = interleave(
        Side("ours", _stepper(env, material.everything, sizes.steps), units),
        Side("CartPole", balance, units),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "step", "vector env", "CartPole vector env")


def measure_single_env(material: Material) -> Measured:
    """The single env, all techniques, against CartPole, both without wrappers."""
    sizes, action = material.sizes, material.everything[0]
    env = TechniqueSelectionEnv(**material.env_arguments)
    _play_checked(env, material, action, {"start": 0})
    cartpole = gym.make("CartPole-v1").unwrapped
    cartpole.reset(seed=0)
    pushes = cycle(np.random.default_rng(0).integers(0, 2, 997).tolist())

    def balance() -> None:
        for _ in range(sizes.steps):
            if cartpole.step(next(pushes))[2]:
                cartpole.reset()

    medians = interleave(
        Side("ours", _stepper(env, action, sizes.steps), sizes.steps),
        Side("CartPole", balance, sizes.steps),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "step", "single env", "CartPole")


def measure_ppo(material: Material) -> Measured:
    """PPO's wall time on the env against the same PPO on an env that returns constants."""
    import torch
    from _bench_constant import ConstantVecEnv
    from stable_baselines3 import PPO

    from agents.adapter import SB3VecEnv

    torch.set_num_threads(1)
    sizes = material.sizes
    env = SB3VecEnv(
        TechniqueSelectionVectorEnv(
            sizes.routes, **material.env_arguments, random_start=True, autoreset_mode="SameStep"
        )
    )
    env.set_options([{"start": int(start)} for start in material.starts])
    env.reset()
    for frame in range(sizes.frames):
        rewards = env.step(material.everything)[1]
        if frame in material.checked_frames():
            material.check_frame(frame, rewards, None)
    constant = ConstantVecEnv(sizes.routes, env.observation_space, env.action_space)
    steps = sizes.routes * sizes.ppo_steps
    sides = []
    for routes in (env, constant):
        model = PPO(
            "MlpPolicy",
            routes,
            n_steps=sizes.ppo_steps,
            batch_size=sizes.ppo_batch,
            seed=0,
            device="cpu",
        )
        sides.append(Side(type(routes).__name__, _learner(model, steps), steps))
    medians = interleave(sides[0], sides[1], sizes.ppo_rounds)
    ratio = 1.0 / medians.faster
    return Measured(ratio, medians, "step", "PPO on the env", "PPO on constants")


def _learner(model: Any, steps: int) -> Callable[[], None]:
    def learn() -> None:
        model.learn(steps, reset_num_timesteps=False)

    return learn


MEASUREMENTS: dict[str, Callable[[Material], Measured]] = {
    "sic_vs_numpy": measure_sic,
    "vector_env_vs_cartpole_vector": measure_vector_env,
    "single_env_vs_cartpole": measure_single_env,
    "ppo_vs_constant_env": measure_ppo,
    "sic_share_of_limit": measure_limit,
}


def _line(name: str, measured: Measured) -> str:
    ours, theirs = (readable(seconds) for seconds in measured.medians)
    what = f"{measured.ours} {ours}, {measured.theirs} {theirs} per {measured.unit}"
    if measured.unit == "byte":
        rates = (1e-9 / seconds for seconds in measured.medians)
        what = "{} {:.3g}, {} {:.3g} GB/s".format(
            measured.ours, next(rates), measured.theirs, next(rates)
        )
    return f"{name:30} {measured.ratio:9.3g}   {what}"


def _parser() -> argparse.ArgumentParser:
    first = (__doc__ or "").splitlines()[0]
    parser = Parser(prog="bench.py", description=first)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="JSON to write")
    parser.add_argument(
        "--quick", action="store_true", help="small sizes: shows that it runs, not how fast it is"
    )
    return parser


def main() -> None:
    """Measure, print and write."""
    args = _parser().parse_args()
    if args.out.is_dir():
        raise ValueError(f"--out {args.out} is a folder; name a file")
    sizes = QUICK if args.quick else Sizes()
    print(
        f"{sizes.techniques} techniques, {sizes.places} places, K = {sizes.candidates},"
        f" F = {sizes.history}, frame {sizes.frames - 1}, {sizes.routes} routes, one thread;"
        f"\nmedians of {sizes.rounds} rounds in which both sides take turns"
        f" ({sizes.ppo_rounds} for PPO)\n\nThe gather in NumPy that SIC is compared with:\n"
    )
    print(inspect.getsource(reference.gather))
    material = Material(sizes)
    ratios = {}
    for name, measure in MEASUREMENTS.items():
        measured = measure(material)
        ratios[name] = measured.ratio
        print(_line(name, measured), flush=True)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(ratios, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    run(main)
