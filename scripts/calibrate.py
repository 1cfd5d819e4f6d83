"""Fit p̂ on simulated routes and write ``amusic_gym/estimation/calibration.json``.

The routes are those of the statistic's own kind: steady drives through changing conditions for SIC,
any motion for the belief.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from _cli import Parser, destination, run
from numpy.typing import NDArray

from amusic_gym import __version__
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.calibration import (
    FILE,
    UNCALIBRATED,
    belief_design,
    design,
    fit_product,
    map_design,
    stored,
)
from amusic_gym.estimation.settings import STATISTICS
from amusic_gym.routes.simulate import POPULATION, TOURS
from amusic_gym.utils.storage import write_whole

RATES = (0.05, 0.1, 0.3, 0.6, 1.0)  # shares of the techniques that run on a frame
SIC_INPUTS = ("confidence", "discount", "track", "on_map", "heard", "support", "margin")
BELIEF_INPUTS = ("confidence", "margin", "log_likelihood", "log_likelihood_mean", "on_map")

LEAVES = 0.18
"""Share of the routes that leave the map.

A place that is carried on while nothing confirms it may be right, at night, or wrong, off the map:
the more routes leave it, the less is believed of either.
"""

Samples = tuple[NDArray[np.float64], NDArray[np.bool_]]
Actions = Callable[[], NDArray[np.bool_]]


def collect(banks: list[ScoreBank], statistic: str, candidates: int, act: Actions) -> Samples:
    """What p̂ is made of, and correctness, of every frame of the banks under some activity.

    Returns:
        (n, 7) ``SIC_INPUTS``, or for the belief (n, 5) ``BELIEF_INPUTS``. And (n,) bool.
    """
    slots = max(len(bank.techniques) for bank in banks)
    env = TechniqueSelectionVectorEnv(
        len(banks), list(banks), slots=slots, statistic=statistic, candidates=candidates
    )
    episodes: Any = env.task.episodes
    names: tuple[str, ...] = SIC_INPUTS
    if statistic == "belief":  # its confidence is a calibrated one
        episodes.estimator.state.calibration[:] = UNCALIBRATED
        names = BELIEF_INPUTS
    env.reset(options={"bank": np.arange(len(banks)), "start": 0})
    inputs, correct = [], []
    for frame in range(max(bank.queries for bank in banks)):
        env.step(act())
        for i, bank in enumerate(banks):
            if frame < bank.queries:
                known, slots_of = episodes.state.routes[i], episodes.state.slots[i]
                discount = slots_of["discount"][slots_of["chosen"] > 0].sum()
                inputs.append([discount if n == "discount" else known[n] for n in names])
                correct.append(bank.truth.is_true(int(known["prediction"]), frame))
    return np.array(inputs, np.float64), np.array(correct)


def sic_fit(samples: Samples, *, rival: bool) -> list[float]:
    """Coefficients of SIC's logit from the frames on which the winner has a rival, or has none."""
    inputs, correct = samples
    wanted = (inputs[:, -1] != 0.0) == rival
    confidence, discount, tens, on_map, *others = inputs[wanted].T
    drive = design(confidence * discount, 10.0 * tens, tuple(others) if rival else None)
    return rounded(fit_product(drive, map_design(on_map), correct[wanted]))


def rounded(coefficients: NDArray[np.float64]) -> list[float]:
    """As the package's file has them."""
    found: list[float] = np.round(coefficients, 4).tolist()
    return found


def calibrate(banks: list[ScoreBank], statistic: str, seed: int) -> dict[str, list[float]]:
    """Coefficients for a statistic, as `calibration.json` has them.

    From drives with the same techniques all the way, with random ones and with a single one. SIC's
    for a winner without a rival are from drives with a single technique and candidate.
    """
    rng = np.random.default_rng(seed)
    shape = (len(banks), max(len(bank.techniques) for bank in banks))
    fixed = rng.random(shape) < 0.4
    fixed[~fixed.any(axis=1), 0] = True
    rates = rng.choice(RATES, (len(banks), 1))
    single = np.eye(shape[1], dtype=np.bool_)[rng.integers(shape[1], size=len(banks))]
    drives = [
        collect(banks, statistic, 50, lambda: fixed),
        collect(banks, statistic, 50, lambda: rng.random(shape) < rates),
        collect(banks, statistic, 50, lambda: single),
    ]
    inputs, correct = (np.concatenate(part) for part in zip(*drives, strict=True))
    if statistic == "belief":
        *drive, on_map = inputs.T
        made = fit_product(belief_design(*drive), map_design(on_map), correct)
        return {"place": rounded(made)}
    lonely = collect(banks, statistic, 1, lambda: single)
    return {
        "rival": sic_fit((inputs, correct), rival=True),
        "alone": sic_fit(lonely, rival=False),
    }


def main(arguments: list[str] | None = None) -> None:
    """Parse, simulate, fit, write."""
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--routes", type=int, default=300, help="simulated routes (300)")
    add("--seed", type=int, default=20, help="first seed of the routes (20)")
    which = "of which; the others stay as they are (all)"
    add("--statistic", nargs="+", choices=STATISTICS, default=list(STATISTICS), help=which)
    default = Path(__file__).parent.parent / "amusic_gym" / "estimation" / FILE
    add("--out", type=destination, default=default, help="the package's file")
    given = parser.parse_args(arguments)
    command = f"python scripts/calibrate.py --routes {given.routes} --seed {given.seed}"
    table: dict[str, Any] = {"made_by": command, "version": __version__, "coefficients": {}}
    table["coefficients"] |= stored()["coefficients"]
    for statistic in given.statistic:
        seeds = [[given.seed, i] for i in range(given.routes)]
        routes = replace(POPULATION if statistic == "belief" else TOURS, leaves=LEAVES)
        banks = [routes.route(np.random.default_rng(seed)) for seed in seeds]
        table["coefficients"][statistic] = calibrate(banks, statistic, given.seed)
        print(statistic, table["coefficients"][statistic])
    write_whole(given.out, (json.dumps(table, indent=1) + "\n").encode())


if __name__ == "__main__":
    run(main)
