"""SIC on a large memory-mapped bank, with 2 GB of memory: a process of its own, run by the bench.

It prints a JSON object: key → value and sentence.
"""

from __future__ import annotations

import json
import resource
import statistics
import sys
import time
from pathlib import Path
from typing import Any

from _timing import one_thread

one_thread()

import _cli  # noqa: E402, F401  (finds the package)

# isort: split
import numpy as np  # noqa: E402

from amusic_gym.banks.bank import ScoreBank  # noqa: E402
from amusic_gym.envs.env import TechniqueSelectionEnv  # noqa: E402

LIMIT = 2 << 30
"""Bytes of memory of its own that the process may have; the mapped bank is the system's."""


def anonymous_bytes() -> int:
    """Memory that is neither a file's nor shared."""
    for line in Path("/proc/self/status").read_text("utf-8").splitlines():
        if line.startswith("RssAnon"):
            return int(line.split()[1]) * 1024
    raise RuntimeError("/proc/self/status does not tell RssAnon; this needs Linux")


def drive(env: Any, action: Any) -> list[float]:
    """Seconds of every step of the route but the first."""
    env.reset(seed=0)
    seconds, ended = [], False
    while not ended:
        start = time.perf_counter()
        ended = env.step(action)[2]
        seconds.append(time.perf_counter() - start)
    return seconds[1:]


def main() -> None:
    """Measure and print."""
    resource.setrlimit(resource.RLIMIT_DATA, (LIMIT, LIMIT))
    scores = np.load(sys.argv[1], mmap_mode="r")
    small = ScoreBank(np.ones((1, 2, 2), np.float32), ["a"], [1.0], tolerance=0)
    drive(TechniqueSelectionEnv(small, carry=False, discount=False), [1])  # compiles
    before = anonymous_bytes()
    techniques, queries, places = scores.shape
    names = [f"technique {t}" for t in range(techniques)]
    truth = np.arange(queries) % places
    bank = ScoreBank(scores, names, np.ones(techniques), tolerance=5, ground_truth=truth)
    env = TechniqueSelectionEnv(bank, statistic="evidence", carry=False, discount=False)
    action = np.ones(techniques, np.int8)
    drive(env, action)  # ranks every row
    run = statistics.median(drive(env, action)) / techniques
    grown = anonymous_bytes() - before
    rates, row = [], np.empty(places, np.float32)
    for query in range(queries):
        start = time.perf_counter()
        for t in range(techniques):
            np.copyto(row, scores[t, query])
        rates.append((time.perf_counter() - start) / techniques)
    plain = statistics.median(rates)
    print(
        json.dumps(
            {
                "big_anonymous_mb": (grown / 1e6, f"MB of memory for {scores.nbytes / 1e9:.3g} GB"),
                "big_run_us": (1e6 * run, f"µs per technique and frame with {places} places"),
                "big_share_of_read": (plain / run, f"to copy a row takes {1e6 * plain:.3g} µs"),
            }
        )
    )


if __name__ == "__main__":
    main()
