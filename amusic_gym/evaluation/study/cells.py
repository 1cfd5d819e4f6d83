"""One cell of a study: a policy with one λ on one route, moving in one way."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.audit import audit
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.extraction.shards import Advance, nothing
from amusic_gym.policies.protocol import Context, Policy
from amusic_gym.policies.trace import Trace
from amusic_gym.routes.motion import KIDNAPPED, PACED, RECORDED
from amusic_gym.routes.retime import retime
from amusic_gym.utils.threads import alone

CONDITIONS = {RECORDED: "as recorded", PACED: "paced", KIDNAPPED: "kidnapped"}
"""Motion along a recording, see `amusic_gym.routes.motion`, → in the words of tables."""

Measures = dict[str, Any]


class Bench:
    """What a worker holds to run cells: the recordings."""

    name = "study"  # as executors call what they hand to their workers

    def __init__(self, banks: Sequence[ScoreBank]) -> None:
        self.banks = tuple(banks)
        self._last: tuple[tuple[int, str, int], ScoreBank] | None = None

    def route(self, bank: int, motion: str, seed: int | None) -> ScoreBank:
        """A recording, re-timed if there is a seed for it; the last one is remembered."""
        if seed is None:
            return self.banks[bank]
        if self._last is None or self._last[0] != (bank, motion, seed):
            self._last = (bank, motion, seed), retime(self.banks[bank], seed, motion)
        return self._last[1]

    def __reduce__(self) -> tuple[Any, ...]:
        return Bench, (self.banks,)


@dataclass(frozen=True)
class Cell:
    """A piece of work for executors: the same numbers in any process, in any order."""

    path: str  # stem of the file that keeps its numbers; changes with all that may change them
    labels: Mapping[str, Any]  # what it is, for tables: see `LABELS`
    bank: int  # index in the bench
    # builds the policy; a function of a module, or a partial of one
    make: Callable[[Context], Policy]
    # ``statistic``, ``carry`` and ``discount`` of a policy that does not bring its own
    chosen: Mapping[str, Any]
    retiming: int | None  # seed of the motion; None: as recorded
    seed: int  # for policies that draw
    size: int  # frames

    def __str__(self) -> str:
        """For a person: route, condition and seed, policy and λ."""
        of = self.labels
        weight = "" if of["compute_weight"] is None else f" λ {of['compute_weight']:g}"
        seed = "" if of["seed"] is None else f" {of['seed']}"
        return f"{of['bank']}, {of['condition']}{seed}: {of['policy']}{weight}"

    def run(self, bench: Bench, advance: Advance = nothing) -> Measures:
        """Run the policy along the route and measure it."""
        measures = measure(alone(self._play, bench))
        advance(self.size)
        return measures

    def _play(self, bench: Bench) -> Trace:
        bank = bench.route(self.bank, self.labels["condition"], self.retiming)
        return rollout(
            self.make(Context.of(bank, seed=self.seed, **self.chosen)),
            bank,
            name=self.labels["policy"],
            compute_weight=self.labels["compute_weight"],
            **self.chosen,
        )


LABELS = (
    "bank",
    "condition",
    "seed",
    "policy",
    "family",
    "member",
    "compute_weight",
    "statistic",
    "carry",
    "costs",
)
"""As in ``results.json``; ``member``: which contestant of the entrant."""

AUDITED = ("p_correct", "gap", "auroc", "calibration_error")
"""Of p̂ over a cell's frames: its mean, its mean minus the accuracy, and its quality."""

MEASURED = ("queries", *metrics.AVERAGED, *AUDITED)  # a cell's numbers


def measure(trace: Trace) -> Measures:
    """The numbers of `MEASURED`, plain Python values.

    A technique that is never right is part of simulated routes: its AUC is 0 without a warning.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* has no correct match", UserWarning)
        row = metrics.summarise(trace)
    held = audit(trace)
    estimated = dict.fromkeys(AUDITED) if held is None else {**held._asdict(), "gap": held.gap}
    return {name: (estimated if name in AUDITED else row)[name] for name in MEASURED}
