"""Fit the rates of the belief on simulated routes and write its ``rates.json``.

CMA-ES (Hansen) looks for the rates under which the belief in the true places is highest, over
routes of which most are re-timed and on which selectors of several kinds choose what runs. Run
``scripts/calibrate.py`` after it: p̂ depends on the rates. ``--start FILE`` goes on from rates that
an earlier run wrote; Ctrl-C writes those found so far.
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from _cli import Parser, destination, run

from amusic_gym import __version__
from amusic_gym.estimation.belief.fitting import PLAIN, Drive, activity, from_unit, score, to_unit
from amusic_gym.estimation.belief.rates import FILE, Rates, fitted
from amusic_gym.routes.simulate import POPULATION
from amusic_gym.utils.storage import read_json, write_whole

HELD_OUT_SEED = 1
STEP = 0.12  # of the search at first, in parts of a rate's limits


def drives(seed: int, routes: int) -> list[Drive]:
    """Simulated routes with drawn activity."""
    made = []
    for i in range(routes):
        rng = np.random.default_rng([seed, i])
        bank = POPULATION.route(rng)
        made.append(Drive(bank, activity(rng, bank)))
    return made


def search(
    start: Rates, routes: list[Drive], batch: int, generations: int, seed: int, threads: int
) -> Rates:
    """The mean of the search's distribution after some generations, or when interrupted.

    Every generation is judged by a batch of routes of its own, so that none is learned by heart.
    """
    import cma

    rng = np.random.default_rng([seed, 0])
    options = {"seed": seed + 1, "bounds": [0, 1], "popsize": 14, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy(to_unit(start).clip(0.01, 0.99), STEP, options)
    with ThreadPoolExecutor(threads) as pool:
        try:
            for generation in range(generations):
                points = strategy.ask()
                drawn = rng.choice(len(routes), min(batch, len(routes)), replace=False)
                judges = [routes[i] for i in drawn]
                losses = [score(judges, from_unit(point), pool)[0] for point in points]
                strategy.tell(points, losses)
                print(f"[{generation + 1}/{generations}] loss {min(losses):.4f}", flush=True)
        except KeyboardInterrupt:
            print("interrupted; the rates found so far are kept", flush=True)
    return from_unit(np.asarray(strategy.result.xfavorite))


def _stored(file: Path) -> Rates:
    try:
        return Rates(**read_json(file, "give one that this wrote")["rates"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{file} holds no rates ({error}); give one that this wrote") from error


def main(arguments: list[str] | None = None) -> None:
    """Parse, simulate, search, write."""
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--routes", type=int, default=1200, help="simulated routes (1200)")
    parser.add_argument("--batch", type=int, default=250, help="of them per generation (250)")
    parser.add_argument("--held-out", type=int, default=200, help="and others to judge by (200)")
    parser.add_argument("--generations", type=int, default=30, help="of the search (30)")
    parser.add_argument("--seed", type=int, default=30, help="of the routes (30)")
    parser.add_argument("--threads", type=int, default=2, help="(2)")
    parser.add_argument("--start", type=Path, help="rates to begin with (plain ones)")
    default = Path(__file__).parent.parent / "amusic_gym" / "estimation" / "belief" / FILE
    parser.add_argument("--out", type=destination, default=default, help="the package's file")
    given = parser.parse_args(arguments)
    start = _stored(given.start) if given.start else PLAIN
    routes, held_out = drives(given.seed, given.routes), drives(HELD_OUT_SEED, given.held_out)
    found = search(start, routes, given.batch, given.generations, given.seed, given.threads)
    rates = Rates(*(float(f"{value:.4g}") for value in found))
    with ThreadPoolExecutor(given.threads) as pool:
        before, after = (score(held_out, each, pool) for each in (fitted(), rates))
    names = ("routes", "batch", "generations", "seed")
    words = " ".join(f"--{name} {getattr(given, name)}" for name in names)
    if given.start:
        words += f" --start {given.start.name}"
    table = {
        "made_by": f"python scripts/fit_belief.py {words}",
        "version": __version__,
        "held_out": {"loss": round(after[0], 4), "accuracy": round(after[1], 4)},
        "rates": rates._asdict(),
    }
    write_whole(given.out, (json.dumps(table, indent=1) + "\n").encode())
    print(f"held-out loss {before[0]:.4f} as ships, {after[0]:.4f} now: {given.out}")


if __name__ == "__main__":
    run(main)
