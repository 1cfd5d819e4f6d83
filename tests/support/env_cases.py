"""What the tests of the environment share: banks, ways to play, and comparisons to the last bit."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

import amusic_gym
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

ENV_NAME = "amusic_gym:amusic_gym/TechniqueSelection-v0"
REGISTERED = [name for name in gym.registry if name.startswith("amusic_gym/")]
EVERYTHING: dict[str, Any] = {
    "reselection": 5,
    "episode_length": 12,
    "random_start": True,
    "compute_weight": (0.1, 3.0),
    "allow_idle": True,
}
assert amusic_gym.ENV_ID in REGISTERED


def random_bank(
    seed: int,
    techniques: int = 3,
    queries: int = 40,
    references: int = 60,
    levels: int = 12,
    names: Sequence[str] | None = None,
    **options: Any,
) -> ScoreBank:
    """A smooth bank of whole scores, so that many are equal; query q is at place q."""
    rng = np.random.default_rng(seed)
    places, frames = np.arange(references), np.arange(queries)[:, None]
    near = np.exp(-0.5 * ((places - frames) / 4.0) ** 2)
    noise = rng.normal(size=(techniques, queries, references))
    noise = (noise + np.roll(noise, 1, 2) + np.roll(noise, -1, 2)) / np.sqrt(3)
    skill = rng.uniform(0.5, 2.5, (techniques, 1, 1))
    scores = np.round(levels / 6 * (noise + skill * near))
    names = names or [f"T{t}" for t in range(techniques)]
    truth = np.minimum(np.arange(queries), references - 1)
    options = {"tolerance": 2, "name": f"bank{seed}", "ground_truth": truth, **options}
    return ScoreBank(scores, names, np.linspace(1.0, 3.0, techniques), **options)


def noisy_bank(
    rng: np.random.Generator, techniques: int, queries: int, references: int, levels: int = 4
) -> ScoreBank:
    """Scores out of a few whole numbers, some rows constant: ties everywhere.

    In every second bank some places are no candidates of some rows, and some rows have none.
    """
    scores = rng.integers(0, levels, (techniques, queries, references)).astype(np.float32)
    scores[rng.random((techniques, queries)) < 0.1] = 3.0
    if rng.random() < 0.5:
        scores[rng.random(scores.shape) < rng.random()] = -np.inf
    names = [f"T{t}" for t in range(techniques)]
    seconds, places = rng.uniform(0.1, 2.0, techniques), rng.integers(-1, references, queries)
    return ScoreBank(scores, names, seconds, tolerance=1, ground_truth=places)


def make(kind: str, bank=None, **arguments):
    """The environment in each way a user may hold it."""
    arguments = {**EVERYTHING, **arguments}
    if kind == "wrapped":
        return gym.make(ENV_NAME, bank=bank, **arguments)
    if kind == "vector":
        return TechniqueSelectionVectorEnv(3, bank, autoreset_mode="SameStep", **arguments)
    return TechniqueSelectionEnv(bank, **arguments)


def random_actions(seed: int, steps: int, shape: tuple[int, ...], reselect: float = 0.1) -> Any:
    """(steps, *shape) random bits; the last one of each action is set more rarely."""
    rng = np.random.default_rng(seed)
    actions = rng.integers(0, 2, (steps, *shape)).astype(np.int8)
    actions[..., -1] = rng.random((steps, *shape[:-1])) < reselect
    return actions


def play(env: Any, actions: Any, seed: int | None = 0) -> list[Any]:
    """Everything that a reset and the steps return; begins anew after each end."""
    returned = [env.reset(seed=seed)]
    for action in actions:
        step = env.step(action)
        returned.append(step)
        if not hasattr(env, "num_envs") and (step[2] or step[3]):
            returned.append(env.reset())
    return returned


def infos_of(env: TechniqueSelectionEnv, actions: Any, **reset: Any) -> list[dict[str, Any]]:
    """The infos of every step of one episode."""
    env.reset(**{"seed": 0, **reset})
    return [env.step(action)[4] for action in actions]


def arrays(value: Any) -> Iterator[Any]:
    """All arrays in nested tuples, lists and dicts."""
    if isinstance(value, np.ndarray):
        yield value
        if value.dtype == object:
            yield from arrays(value.tolist())
    elif isinstance(value, dict):
        for part in value.values():
            yield from arrays(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from arrays(part)


def assert_same(first: Any, second: Any, path: str = "") -> None:
    """Bit for bit the same types, shapes, dtypes and values."""
    assert type(first) is type(second), (path, type(first), type(second))
    if isinstance(first, dict):
        assert first.keys() == second.keys(), (path, first.keys() ^ second.keys())
        for key in first:
            assert_same(first[key], second[key], f"{path}/{key}")
    elif isinstance(first, list | tuple):
        assert len(first) == len(second), path
        for number, pair in enumerate(zip(first, second, strict=True)):
            assert_same(*pair, f"{path}[{number}]")
    elif isinstance(first, np.ndarray):
        assert first.dtype == second.dtype, (path, first.dtype, second.dtype)
        assert first.shape == second.shape, (path, first.shape, second.shape)
        if first.dtype == object:
            assert_same(first.tolist(), second.tolist(), path)
        else:
            assert first.tobytes() == second.tobytes(), (path, first, second)
    else:
        assert first == second, (path, first, second)


def digest(value: Any) -> str:
    """A fingerprint of nested returns, the same in every process."""
    state = hashlib.sha256()

    def add(part: Any) -> None:
        if isinstance(part, dict):
            for key in sorted(part):
                state.update(key.encode())
                add(part[key])
        elif isinstance(part, list | tuple):
            for item in part:
                add(item)
        elif isinstance(part, np.ndarray) and part.dtype == object:
            add(part.tolist())
        elif isinstance(part, np.ndarray):
            state.update(str((part.dtype, part.shape)).encode() + part.tobytes())
        else:
            state.update(repr(part).encode())

    add(value)
    return state.hexdigest()
