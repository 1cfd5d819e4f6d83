"""Fit p̂ on simulated routes and write ``amusic_gym/calibration.json``.

The routes are drawn under ordinary conditions: no technique is blind in any of them, as none is on
the recordings that the simulation was compared with. docs/fidelity.md says what other populations
give. For the belief, which follows any motion, half of the routes are re-timed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from _cli import Parser, run
from numpy.typing import NDArray

from amusic_gym import __version__
from amusic_gym.bank import ScoreBank
from amusic_gym.calibration import FILE, UNCALIBRATED, design, fit
from amusic_gym.routes.simulate import Simulation
from amusic_gym.settings import STATISTICS
from amusic_gym.trace import write_whole
from amusic_gym.vector_env import TechniqueSelectionVectorEnv

ORDINARY = Simulation(
    queries=(50, 400), ability=(0.5, 0.95), exclusive=0.0, useless=0.0, all_fail=0.0
)
ROUTES = {  # statistic -> what its routes are drawn from
    "mean": ORDINARY,
    "evidence": ORDINARY,
    "belief": replace(ORDINARY, retimed=0.5),
}
RATES = (0.1, 0.3, 0.6, 0.9)  # shares of the techniques that run on a frame

Samples = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]
Actions = Callable[[], NDArray[np.bool_]]


def collect(banks: list[ScoreBank], statistic: str, candidates: int, act: Actions) -> Samples:
    """Statistic, margin and correctness of every frame of the banks under some activity."""
    env = TechniqueSelectionVectorEnv(
        len(banks), list(banks), statistic=statistic, candidates=candidates
    )
    if statistic == "belief":  # whose confidence is calibrated; what is fitted must not be
        episodes = env.task.episodes
        episodes.rules = episodes.rules._replace(calibration=np.array(UNCALIBRATED))
    env.reset(options={"bank": np.arange(len(banks)), "start": 0})
    confidence, margin, correct = [], [], []
    for frame in range(max(bank.queries for bank in banks)):
        _, _, _, _, info = env.step(act())
        for i, bank in enumerate(banks):
            if frame < bank.queries:
                place = info["prediction"][i : i + 1]
                confidence.append(info["confidence"][i])
                margin.append(info["margin"][i])
                correct.append(bank.truth.correct(place, np.array([frame]))[0])
    return np.array(confidence), np.array(margin), np.array(correct)


def calibrate(banks: list[ScoreBank], statistic: str, seed: int) -> dict[str, list[float]]:
    """Coefficients for a statistic: with a rival, and alone (one candidate, one technique)."""
    rng = np.random.default_rng(seed)
    shape = (len(banks), len(banks[0].techniques))
    fixed = rng.random(shape) < 0.4
    fixed[~fixed.any(axis=1), 0] = True
    rates = rng.choice(RATES, (len(banks), 1))
    single = np.eye(shape[1], dtype=np.bool_)[rng.integers(shape[1], size=len(banks))]
    steady = collect(banks, statistic, 50, lambda: fixed)
    random = collect(banks, statistic, 50, lambda: rng.random(shape) < rates)
    confidence, margin, correct = (
        np.concatenate(pair) for pair in zip(steady, random, strict=True)
    )
    belief = statistic == "belief"
    with_rival = fit(design(confidence, margin, logarithms=belief), correct)
    fitted = {"rival": np.round(with_rival, 4).tolist()}
    if not belief:  # there, every place is a candidate
        alone = collect(banks, statistic, 1, lambda: single)
        fitted["alone"] = np.round(fit(design(alone[0], None), alone[2]), 4).tolist()
    return fitted


def main(arguments: list[str] | None = None) -> None:
    """Parse, simulate, fit, write."""
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--routes", type=int, default=300, help="simulated routes (300)")
    parser.add_argument("--seed", type=int, default=20, help="first seed of the routes (20)")
    default = Path(__file__).parent.parent / "amusic_gym" / FILE
    parser.add_argument("--out", type=Path, default=default, help="the package's file")
    given = parser.parse_args(arguments)
    table: dict[str, Any] = {
        "made_by": f"python scripts/calibrate.py --routes {given.routes} --seed {given.seed}",
        "version": __version__,
        "coefficients": {},
    }
    for statistic in STATISTICS:
        seeds = [[given.seed, i] for i in range(given.routes)]
        banks = [ROUTES[statistic].route(np.random.default_rng(seed)) for seed in seeds]
        table["coefficients"][statistic] = calibrate(banks, statistic, given.seed)
        print(statistic, table["coefficients"][statistic])
    write_whole(given.out, (json.dumps(table, indent=1) + "\n").encode())


if __name__ == "__main__":
    run(main)
