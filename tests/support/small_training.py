"""Trainings small enough for tests, also behind the real command.

As a program: ``small_training.py CODE ARGUMENT...`` runs ``scripts/train.py ARGUMENT...`` with
small defaults, after CODE, which may break something on purpose.
"""

from __future__ import annotations

import importlib
import os
import runpy
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

from amusic_agents.config import ImitationConfig, RolloutConfig, TrainingConfig, training_config
from amusic_agents.evaluation import HeldOut
from env_cases import random_bank
from safetensors.torch import load_file

from amusic_gym.evaluation.rollout import Job

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
SMALL: dict[str, Any] = {
    "n_envs": 4,
    "n_steps": 8,
    "epochs": 1,
    "evaluate_every": 64,
    "held_out": 1,
    "pool": 2,
}
"""32 frames an update; an evaluation before every third."""
TRIED: dict[str, Any] = {
    **{"iterations": 4, "states": 8, "kept": 2, "subsets": 4, "hold": 2, "horizon": 6},
    **{"every": 3, "epochs": 2, "batch_size": 4},
}
"""Four iterations of eight states; of the last two's is learned."""


def small(algorithm: str = "imitation", **changes: Any) -> TrainingConfig:
    """Three rounds of 4 · 20 frames, then 96 frames of PPO."""
    settings = {"rounds": 3, "frames": 80, "epochs": 2, "batch_size": 64}
    settings |= changes.pop("imitation", {})
    given = {**SMALL, "timesteps": 96, "imitation": ImitationConfig(**settings), **changes}
    return training_config(algorithm, **given)


def small_rollouts(**changes: Any) -> TrainingConfig:
    """Policy iteration of `TRIED`."""
    tried = RolloutConfig(**{**TRIED, **changes.pop("rollouts", {})})
    return training_config("rollouts", **{**SMALL, "rollouts": tried, **changes})


class Quick(HeldOut):
    """Held-out routes that take no time."""

    def __init__(
        self, routes: int, statistic: str, within: tuple[float, float] = (0.0, 1.0)
    ) -> None:
        self.jobs = [Job(random_bank(77, queries=12), 0.5)]
        self.statistic = statistic


def learn_and_die_once(marker: Path, out: Path, config: Any, resume: bool, evaluated: Any) -> None:
    """A training for `tune`; the first to be evaluated twice kills its process.

    Where the marker is, none does.
    """
    from amusic_agents import records
    from amusic_agents.training import train

    records.HeldOut = Quick  # type: ignore[misc]
    seen = 0

    def told(evaluation: Any) -> None:
        nonlocal seen
        seen += 1
        if seen == 2 and not marker.exists():
            marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        evaluated(evaluation)

    train(out, config, banks=[random_bank(1)], resume=resume, evaluated=told, progress=False)


def stop_at(monkeypatch: Any, owner: Any, name: str, call: int) -> None:
    """Ctrl-C at the given call of ``owner.name``."""
    original, calls = getattr(owner, name), [0]

    def counting(*arguments: Any, **keywords: Any) -> Any:
        calls[0] += 1
        if calls[0] == call:
            raise KeyboardInterrupt
        return original(*arguments, **keywords)

    monkeypatch.setattr(owner, name, counting)


def contents(run: Path) -> dict[str, bytes]:
    """What a run folder says; of a checkpoint the tensors, for its metadata have no order."""
    files = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    del files["checkpoint.safetensors"]
    tensors = load_file(run / "checkpoint.safetensors")
    return files | {name: tensor.numpy().tobytes() for name, tensor in tensors.items()}


def train_script(*arguments: object, code: str = "") -> subprocess.CompletedProcess[str]:
    """Run the command with small defaults in a process of its own, where warnings are errors."""
    command = [sys.executable, "-W", "error", __file__, code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)


def signal_at(module: str, name: str, call: int, number: signal.Signals) -> str:
    """Code for `train_script`: the process gets a signal when ``name`` is called so often."""
    return f"import small_training; small_training.arm({module!r}, {name!r}, {call}, {number:d})"


def arm(module: str, name: str, call: int, number: int) -> None:
    """Do what `signal_at` says."""
    owner: Any = importlib.import_module(module)
    *path, last = name.split(".")
    for part in path:
        owner = getattr(owner, part)
    original = getattr(owner, last)
    count = 0

    def counting(*arguments: Any, **keywords: Any) -> Any:
        nonlocal count
        count += 1
        if count == call:
            os.kill(os.getpid(), number)
        return original(*arguments, **keywords)

    setattr(owner, last, counting)


def _main(code: str, *arguments: str) -> None:
    sys.path[:0] = [str(SCRIPTS.parent), str(SCRIPTS)]
    import amusic_agents.config as config

    config.TrainingConfig = partial(config.TrainingConfig, **SMALL)  # type: ignore[assignment,misc]
    exec(code, {})
    sys.argv = [str(SCRIPTS / "train.py"), *arguments]
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    _main(*sys.argv[1:])
