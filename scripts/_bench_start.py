"""What a user waits for: the import, and the first step with and without compiled code."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

IMPORT = """
import time
start = time.perf_counter()
import amusic_gym
print(time.perf_counter() - start)
"""

FIRST_STEP = """
import time
import gymnasium as gym
import amusic_gym
env = gym.make("amusic_gym/TechniqueSelection-v0", statistic={statistic!r})
start = time.perf_counter()
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.perf_counter() - start)
"""


def seconds_of(program: str, cache: Path) -> float:
    """What a program prints, in a process of its own that keeps compiled code in ``cache``."""
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": paths},
    )
    return float(done.stdout)


def measure_start(
    statistics: dict[str, str], rounds: int, report: Callable[[str, float, str], None]
) -> None:
    """Measure the import and, per statistic, the first reset and step, cold and cached.

    Args:
        statistics: prefix of the keys → statistic.
        rounds: processes per figure, of which the median counts; a cold start is measured once.
        report: takes a key, its value, and a sentence on it.
    """
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder)
        imports = sorted(seconds_of(IMPORT, cache) for _ in range(rounds))
        report("import_seconds", imports[rounds // 2], "s to import amusic_gym")
        for prefix, statistic in statistics.items():
            program = FIRST_STEP.format(statistic=statistic)
            own = cache / statistic
            cold = seconds_of(program, own)
            cached = sorted(seconds_of(program, own) for _ in range(rounds))[rounds // 2]
            what = f"s to the first step with {statistic}, Numba's import included"
            report(f"{prefix}first_step_cold_seconds", cold, f"{what}, nothing compiled before")
            report(f"{prefix}first_step_cached_seconds", cached, f"{what}, compiled before")
