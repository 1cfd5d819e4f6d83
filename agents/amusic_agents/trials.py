"""The trainings of a search: pieces of work for executors, one per trial and seed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from amusic_agents.config import TrainingConfig
from amusic_agents.evaluation import Evaluation
from amusic_agents.run_folder import CONFIG
from amusic_gym.extraction.shards import Advance, nothing
from amusic_gym.utils.optional import optional

Learn = Callable[[Path, TrainingConfig, bool, Callable[[Evaluation], None]], object]
"""Trains in a run folder, from its last checkpoint if True, and tells of every evaluation."""

Scores = tuple[float, ...]  # held-out scores of a training or trial, by evaluation


@dataclass(frozen=True)
class Learner:
    """What workers hold to run trainings."""

    learn: Learn  # what trains; for other executors than ``serial`` it must pickle
    name = "tune"  # as executors call it


class Reached(NamedTuple):
    """What a training reached: its scores, and whether it was pruned."""

    scores: Scores
    pruned: bool


@dataclass(frozen=True)
class Training:
    """One training of a trial: the same scores in any process, in any order.

    A worker that dies leaves a checkpoint in the run folder, from which the next one goes on.
    """

    trial: int  # its number
    folder: Path  # the run folder; workers on other machines must find it, too
    config: TrainingConfig
    completed: Sequence[Scores] = ()  # scores of trials that may prune this one; empty: none do

    @property
    def size(self) -> int:
        """Frames."""
        return self.config.timesteps

    def __str__(self) -> str:
        return f"training in {self.folder}"

    def run(self, learner: Learner, advance: Advance = nothing) -> Reached:
        """Train to the end, or until the scores are behind those of completed trials."""
        optuna = load_optuna()
        judged = _trial_after(self.completed)
        scores: list[float] = []

        def evaluated(evaluation: Evaluation) -> None:
            scores.append(evaluation.score)
            judged.report(evaluation.score, len(scores))
            if judged.should_prune():
                raise optuna.TrialPruned

        pruned = False
        try:
            learner.learn(self.folder, self.config, (self.folder / CONFIG).exists(), evaluated)
        except optuna.TrialPruned:
            pruned = True
        advance(self.size)
        return Reached(tuple(scores), pruned)


def _trial_after(completed: Sequence[Scores]) -> Any:
    """A trial of a study in memory, in which these were completed before."""
    optuna = load_optuna()
    study = optuna.create_study(direction="maximize", pruner=optuna.pruners.MedianPruner())
    for scores in completed:
        told = dict(enumerate(scores, 1))
        study.add_trial(optuna.trial.create_trial(value=max(scores), intermediate_values=told))
    return study.ask()


def load_optuna() -> Any:
    """Optuna, which says nothing of its own; raises a ValueError if it is not installed."""
    optuna = optional("optuna", "tuning", "Optuna", "tune")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna
