"""Fit p̂ on simulated routes and write ``amusic_gym/calibration.json``.

For `mean` and `evidence` the routes are drawn under ordinary conditions: no technique is blind in
any of them, as none is on the recordings that the simulation was compared with. docs/fidelity.md
says what other populations give. For the belief, which follows any motion and learns whom to trust,
they are those that its rates are fitted on.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from _cli import Parser, run
from numpy.typing import NDArray

from amusic_gym import __version__
from amusic_gym.bank import ScoreBank
from amusic_gym.calibration import FILE, UNCALIBRATED, belief_design, design, fit
from amusic_gym.routes.simulate import POPULATION, Simulation
from amusic_gym.settings import STATISTICS
from amusic_gym.trace import write_whole
from amusic_gym.vector_env import TechniqueSelectionVectorEnv

ORDINARY = Simulation(
    queries=(50, 400), ability=(0.5, 0.95), exclusive=0.0, useless=0.0, all_fail=0.0
)
ROUTES = {"mean": ORDINARY, "evidence": ORDINARY, "belief": POPULATION}  # per statistic
RATES = (0.1, 0.3, 0.6, 0.9)  # shares of the techniques that run on a frame

Samples = tuple[NDArray[np.float64], NDArray[np.bool_]]
Actions = Callable[[], NDArray[np.bool_]]


def collect(banks: list[ScoreBank], statistic: str, candidates: int, act: Actions) -> Samples:
    """What p̂ is made of, and correctness, of every frame of the banks under some activity.

    Returns:
        (n, 2) confidence and margin; for the belief (n, 4), as `belief_design` takes them. And
        (n,) bool.
    """
    slots = max(len(bank.techniques) for bank in banks)
    env = TechniqueSelectionVectorEnv(
        len(banks), list(banks), slots=slots, statistic=statistic, candidates=candidates
    )
    episodes, names = env.task.episodes, ["confidence", "margin"]
    if statistic == "belief":  # its confidence is a calibrated one
        episodes.rules.calibration[:] = UNCALIBRATED
        names += ["said", "said_mean"]
    env.reset(options={"bank": np.arange(len(banks)), "start": 0})
    inputs, correct = [], []
    for frame in range(max(bank.queries for bank in banks)):
        env.step(act())
        for i, bank in enumerate(banks):
            if frame < bank.queries:
                known = episodes.state.routes[i : i + 1]
                inputs.append([known[name][0] for name in names])
                correct.append(bank.truth.correct(known["prediction"], np.array([frame]))[0])
    return np.array(inputs), np.array(correct)


def calibrate(banks: list[ScoreBank], statistic: str, seed: int) -> dict[str, list[float]]:
    """Coefficients for a statistic, as `calibration.json` has them.

    For SIC with a rival, and alone (one candidate, one technique); for the belief of the place.
    """
    rng = np.random.default_rng(seed)
    shape = (len(banks), max(len(bank.techniques) for bank in banks))
    fixed = rng.random(shape) < 0.4
    fixed[~fixed.any(axis=1), 0] = True
    rates = rng.choice(RATES, (len(banks), 1))
    single = np.eye(shape[1], dtype=np.bool_)[rng.integers(shape[1], size=len(banks))]
    steady = collect(banks, statistic, 50, lambda: fixed)
    random = collect(banks, statistic, 50, lambda: rng.random(shape) < rates)
    inputs, correct = (np.concatenate(pair) for pair in zip(steady, random, strict=True))
    if statistic == "belief":
        return {"place": np.round(fit(belief_design(*inputs.T), correct), 4).tolist()}
    lonely, right = collect(banks, statistic, 1, lambda: single)
    return {
        "rival": np.round(fit(design(*inputs.T), correct), 4).tolist(),
        "alone": np.round(fit(design(lonely[:, 0], None), right), 4).tolist(),
    }


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
