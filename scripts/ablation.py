"""Measure what the selector that ships for a statistic makes of the observation's features.

A line for each GROUP: what the score, accuracy less λ times compute, loses on simulated routes
where the selector reads the mean of these features, with 95 % of a bootstrap over the routes.
Each FEATURE is NAME of the route's group or technique.NAME.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from _cli import Parser, run
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.observation import ROUTE_FEATURES, TECHNIQUE_FEATURES, WIDTH
from amusic_gym.estimation.settings import STATISTICS
from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.rollout import Job, rollouts
from amusic_gym.routes.simulate import population

WEIGHTS = (0.05, 0.15, 0.3, 0.6)
DRAWS = 4000  # of the bootstrap
NAMES = tuple(f"technique.{name}" for name in TECHNIQUE_FEATURES) + ROUTE_FEATURES


class Ablated:
    """A selector that reads ``means`` of some features (feature → number); it keeps the others'."""

    def __init__(self, selector: Any, means: Mapping[str, float]) -> None:
        self.selector, self.means, self.needs = selector, means, selector.needs
        self.reset = selector.reset
        self.read: list[NDArray[np.float32]] = []

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """What the selector does."""
        seen = observation.copy()
        for name, mean in self.means.items():
            entries(seen, name)[:] = mean
        self.read.append(seen)
        acted: NDArray[np.bool_] = self.selector.act(seen, info)
        return acted


def entries(observation: NDArray[np.float32], name: str) -> NDArray[np.float32]:
    """The entries of a feature in observations (N, D), as a view: (N,), or (N, S)."""
    if name in ROUTE_FEATURES:
        return observation[:, ROUTE_FEATURES.index(name) - len(ROUTE_FEATURES)]
    return observation[:, NAMES.index(name) : -len(ROUTE_FEATURES) : WIDTH]


def means_of(read: Sequence[NDArray[np.float32]]) -> dict[str, float]:
    """Mean of every feature over observations, each (N, D); a technique's where there is one."""
    seen = np.concatenate(read)
    present = entries(seen, "technique.present") > 0
    return {
        name: float(entries(seen, name)[present if "." in name else slice(None)].mean())
        for name in NAMES
    }


def scores_of(policy: Ablated, banks: Sequence[ScoreBank], weight: float) -> NDArray[np.float64]:
    """Accuracy less λ times compute on every route (N,)."""
    traces = rollouts(policy, [Job(bank, weight) for bank in banks], name="ablated")
    return np.array([trace.correct.mean() - weight * metrics.compute(trace) for trace in traces])


def main() -> None:
    """Drive with all features, then without those of each group."""
    parser = Parser(description=__doc__)
    add = parser.add_argument
    add("group", nargs="*", metavar="GROUP", help="FEATURE,FEATURE...; none: each by itself")
    add("--statistic", choices=STATISTICS, default="belief")
    add("--routes", type=int, default=40, metavar="N", help="simulated routes (40)")
    add("--seed", type=int, default=4242, metavar="S", help="of the routes (4242)")
    args = parser.parse_args()
    groups = [group.split(",") for group in args.group or NAMES]
    if unknown := {name for group in groups for name in group} - set(NAMES):
        raise ValueError(f"no feature is called {sorted(unknown)[0]!r}; give any of {list(NAMES)}")
    from amusic_agents.selector import load_selector  # PyTorch takes seconds, --help needs none

    routes, selector = population(args.statistic), load_selector(statistic=args.statistic)
    seeds = [[args.seed, i] for i in range(args.routes)]
    banks = [routes.route(np.random.default_rng(seed)) for seed in seeds]
    whole = {weight: Ablated(selector, {}) for weight in WEIGHTS}
    scores = {weight: scores_of(whole[weight], banks, weight) for weight in WEIGHTS}
    means = {weight: means_of(whole[weight].read) for weight in WEIGHTS}
    print("| read as their mean | " + " | ".join(f"λ {weight}" for weight in WEIGHTS) + " |")
    print("|---" * (len(WEIGHTS) + 1) + "|")
    print("| nothing: score | " + " | ".join(f"{scores[w].mean():.4f}" for w in WEIGHTS) + " |")
    for group in groups:
        cells = []
        for weight in WEIGHTS:
            policy = Ablated(selector, {name: means[weight][name] for name in group})
            lost = scores[weight] - scores_of(policy, banks, weight)
            drawn = np.random.default_rng(0).choice(lost, (DRAWS, lost.size)).mean(axis=1)
            low, high = np.quantile(drawn, (0.025, 0.975))
            cells.append(f"{lost.mean():+.4f} ({low:+.4f} to {high:+.4f})")
        print(f"| {', '.join(group)} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    run(main)
