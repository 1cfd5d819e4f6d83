"""Reference rewards: what rules and selectors reach in the environment without a bank.

Drives simulated routes of four techniques, which no training draws, once for every λ, and says
the mean reward per frame as the environment gives it (p̂ - λ · compute) and what of it is true
(correct - λ · compute). Any policy that chooses techniques may be named, such as ppo:RUN.
"""

import argparse
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.cli.parser import Parser, add_statistic, correction_of, destination
from amusic_gym.envs.sources import ordinary
from amusic_gym.evaluation.contestants import check_weights
from amusic_gym.evaluation.rollout import Job
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.protocol import Context, Selector
from amusic_gym.utils.checks import whole
from amusic_gym.utils.storage import write_whole

POLICIES = ("random:0", "random:0.5", "music", "cascade", "voi", "amusic:evidence", "ppo")
"""The cheapest technique, any, all, rules that look, and the selector that ships."""

KINDS = ("Reward per frame, p̂ - λ · compute", "True reward per frame, correct - λ · compute")


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    from amusic_agents.evaluation import COMPUTE_WEIGHTS

    parser.add_shared("--policy", nargs="+", default=list(POLICIES))
    routes = "simulated routes (default: %(default)s)"
    parser.add_argument("--routes", type=int, default=64, help=routes)
    parser.add_shared("--compute-weight", default=list(COMPUTE_WEIGHTS))
    add_statistic(parser, "for all policies that have none of their own")
    parser.add_shared("--seed")
    file = {"required": False, "metavar": "FILE", "help": "write the tables, too"}
    parser.add_shared("--out", type=destination, **file)


def main(args: argparse.Namespace) -> None:
    """Print a table of rewards and one of true rewards."""
    from amusic_agents.evaluation import held_out_routes

    how = correction_of(args)
    weights = check_weights(args.compute_weight)
    banks = held_out_routes(ordinary(how["statistic"]), whole("--routes", args.routes, 2))
    found = reference_rewards(args.policy, banks, weights, seed=args.seed, **how)
    shown = tables(found, weights, sum(bank.queries for bank in banks) / len(banks))
    print("\n\n".join(table.text() for table in shown))
    if args.out is not None:
        write_whole(args.out, "\n\n".join(t.markdown() for t in shown).encode() + b"\n")


def reference_rewards(
    policies: Sequence[str],
    banks: Sequence[ScoreBank],
    weights: Sequence[float],
    *,
    seed: int = 0,
    progress: bool = True,
    **how: Any,
) -> dict[str, NDArray[np.float64]]:
    """Rewards per frame of each policy, (2, B, L): by p̂, and by what is true."""
    from amusic_agents.evaluation import measure
    from amusic_baselines import make_policy

    def selector(name: str, bank: ScoreBank) -> Selector:
        policy = make_policy(name, Context.of(bank, seed=seed, **how))
        if not isinstance(policy, Selector):
            raise ValueError(
                f"{name} gives places itself, for which the environment has no reward; name a"
                " policy that chooses techniques"
            )
        return policy

    for name in policies:  # refuse before the work
        selector(name, banks[0])
    drives = [(name, bank) for name in dict.fromkeys(policies) for bank in banks]
    found: dict[str, list[Any]] = {name: [] for name in policies}
    bar: Iterable[tuple[str, ScoreBank]] = tqdm(drives, unit="route", disable=not progress)
    for name, bank in bar:
        jobs = [Job(bank, weight) for weight in weights]
        accuracy, cost, p_correct = measure(selector(name, bank), jobs, **how)
        price = np.array(weights) * cost
        found[name].append((p_correct - price, accuracy - price))
    return {name: np.array(rows).transpose(1, 0, 2) for name, rows in found.items()}


def tables(
    found: dict[str, NDArray[np.float64]], weights: Sequence[float], frames: float
) -> list[Table]:
    """Mean rewards over the routes by λ, then what of them is true."""
    heads = ["policy", *(f"λ {weight:g}" for weight in weights)]
    shown = []
    for kind, title in enumerate(KINDS):
        rows = [[key, *(f"{v:.3f}" for v in each[kind].mean(0))] for key, each in found.items()]
        errors = [each[kind].std(0, ddof=1) / np.sqrt(each.shape[1]) for each in found.values()]
        routes = next(iter(found.values())).shape[1]
        note = (
            f"Means over {routes} routes, of {frames:.0f} frames in the mean; the largest standard"
            f" error is {np.max(errors):.3f}. All policies drive the same routes."
        )
        shown.append(Table(title, heads, rows, note))
    return shown
