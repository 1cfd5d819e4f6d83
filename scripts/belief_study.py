"""What each part of the belief is worth: AUC with the part left out, as recorded and re-timed.

Every bank is driven as it is and re-timed with ``--seeds`` seeds, by the cheapest technique, the
cheapest two, and all. Prints a table and writes it to ``--out`` as Markdown. The sums along
diagonals (``evidence``) stand beside, at three γ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from _cli import Parser, destination, run

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.belief.fitting import Drive
from amusic_gym.estimation.belief.rates import Rates, fitted
from amusic_gym.evaluation.metrics import area, precision_recall
from amusic_gym.routes.retime import retime
from amusic_gym.routes.simulate import POPULATION
from amusic_gym.utils.escaping import for_markdown
from amusic_gym.utils.storage import write_whole

WITHOUT = {
    "all of it": {},
    "hubs": {"hub": 0.0, "hub_spread": 0.0},
    "wandering": {"wandering": 0.0},
    "steady motion": {"steady": 0.0, "settle": 0.0},
    "changes of speed": {"change": 0.0},
    "jumps": {"jump": 1e-12, "steady_jump": 1e-12},
    "discount of repetitions": {"repeat": 1.0},
    "standing seen in equal rows": {"stand": 1.0},
    "jumps seen in changed rows": {"jump_novel": 0.0},
    "trust below certainty": {"trust": 0.99, "learn": 0.0},
    "rows of several kinds of sharpness": {"sharper": 0.0},
    "learning whom to trust": {"learn": 0.0},
}
GAMMAS = (1.0, 0.9, 0.8)
ACTIVE = (1, 2, 0)  # cheapest techniques that run; 0: all
HEADS = tuple(f"{when}, {who}" for when in ("recorded", "re-timed") for who in ("1", "2", "all"))


def active(bank: ScoreBank, count: int) -> np.ndarray:
    """(T,) bool, the cheapest ``count`` techniques; 0: all."""
    chosen = np.zeros(len(bank.techniques), np.bool_)
    chosen[np.argsort(bank.seconds, kind="stable")[: count or None]] = True
    return chosen


def believed(bank: ScoreBank, ran: np.ndarray, rates: Rates) -> float:
    """AUC of the belief, its share around the prediction being the confidence."""
    places, beliefs = Drive(bank, np.tile(ran, (bank.queries, 1))).drive(rates)
    return _auc(bank, places, beliefs[:, 0])


def summed(bank: ScoreBank, ran: np.ndarray, gamma: float) -> float:
    """AUC of evidence at a γ."""
    env = TechniqueSelectionVectorEnv(1, bank, statistic="evidence", gamma=gamma)
    env.reset(options={"start": 0})
    infos = [env.step(ran[None])[-1] for _ in range(bank.queries)]
    places = np.array([info["prediction"][0] for info in infos])
    return _auc(bank, places, np.array([info["confidence"][0] for info in infos]))


def _auc(bank: ScoreBank, places: np.ndarray, confidence: np.ndarray) -> float:
    correct, queries = bank.truth.correct(places), int(bank.truth.has_place.sum())
    return area(*precision_recall(correct, confidence, queries)) if correct.any() else 0.0


def row(
    banks: Sequence[ScoreBank], seeds: int, auc: Callable[[ScoreBank, np.ndarray], float]
) -> list[float]:
    """Mean AUC over banks, and seeds where re-timed, in the order of `HEADS`."""
    moved = [retime(bank, seed) for bank in banks for seed in range(seeds)]
    return [
        float(np.mean([auc(bank, active(bank, count)) for bank in group]))
        for group in (list(banks), moved)
        for count in ACTIVE
    ]


def main(arguments: list[str] | None = None) -> None:
    """Parse, drive, print, write."""
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--bank", nargs="+", action="extend", default=[], metavar="BANK", help="folders")
    add("--simulated", type=int, default=0, metavar="N", help="and so many simulated routes (0)")
    add("--seeds", type=int, default=3, help="re-timings of each bank (3)")
    add("--costs", default="measured", help="cost model (measured)")
    add("--out", type=destination, help="Markdown file")
    given = parser.parse_args(arguments)
    banks = [ScoreBank.load(folder).with_costs(given.costs) for folder in given.bank]
    for i in range(given.simulated):
        still = replace(POPULATION, retimed=0.0)
        banks.append(still.route(np.random.default_rng([4_000_000, i])))
    if not banks:
        parser.error("no routes; give --bank, --simulated or both")
    lines = [["", *HEADS]]
    for gamma in GAMMAS:
        values = row(banks, given.seeds, partial(summed, gamma=gamma))
        lines.append([f"evidence, γ = {gamma:g}", *(f"{value:.3f}" for value in values)])
        print("  ".join(lines[-1]), flush=True)
    for name, changes in WITHOUT.items():
        rates = fitted()._replace(**changes)
        values = row(banks, given.seeds, partial(believed, rates=rates))
        title = "belief" if not changes else f"belief without {name}"
        lines.append([title, *(f"{value:.3f}" for value in values)])
        print("  ".join(lines[-1]), flush=True)
    if given.out:
        rule = ["---"] * len(lines[0])
        text = "\n".join(
            "| " + " | ".join(map(for_markdown, line)) + " |"
            for line in (lines[0], rule, *lines[1:])
        )
        write_whole(given.out, f"{text}\n".encode())
        print(given.out)


if __name__ == "__main__":
    run(main)
