"""Trainings small enough for tests, also behind the real command.

As a program: ``small_training.py CODE ARGUMENT...`` runs ``scripts/train.py ARGUMENT...`` with
small defaults, after CODE, which may break something on purpose.
"""

from __future__ import annotations

import os
import runpy
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = ROOT / "scripts"
SMALL: dict[str, Any] = {
    "n_envs": 4,
    "n_steps": 8,
    "epochs": 1,
    "evaluate_every": 64,
    "held_out": 1,
    "pool": 2,
}
"""32 frames an update; an evaluation before every third."""


def interrupt_at(place: str, name: str, call: int) -> str:
    """Code that sends Ctrl-C to the process itself when ``place.name`` is called so often."""
    module = place.rpartition(".")[0] if place[place.rfind(".") + 1].isupper() else place
    return (
        f"import {module}, small_training, signal\n"
        f"small_training.before_call({place}, {name!r}, {call}, signal.SIGINT)"
    )


def before_call(owner: Any, name: str, call: int, number: signal.Signals) -> None:
    """Send a signal to this process just before the given call of ``owner.name``."""
    original = getattr(owner, name)
    count = 0

    def counting(*args: Any, **kwargs: Any) -> Any:
        nonlocal count
        count += 1
        if count == call:
            os.kill(os.getpid(), number)
        return original(*args, **kwargs)

    setattr(owner, name, counting)


def train_script(
    *arguments: object, code: str = "", warnings: str = "error"
) -> subprocess.CompletedProcess[str]:
    """Run the command with small defaults in a process of its own."""
    command = [sys.executable, "-W", warnings, __file__, code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)


def main(code: str, *arguments: str) -> None:
    """Run the command here."""
    sys.path[:0] = [str(ROOT), str(SCRIPTS)]
    import agents.config as config

    config.TrainingConfig = partial(config.TrainingConfig, **SMALL)  # type: ignore[misc]
    sys.modules["small_training"] = sys.modules["__main__"]
    exec(code, {})
    sys.argv = [str(SCRIPTS / "train.py"), *arguments]
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main(*sys.argv[1:])
