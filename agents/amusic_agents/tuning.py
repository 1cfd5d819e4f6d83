"""A study of a training's settings by Optuna: which reach the highest held-out score.

A study folder holds Optuna's journal, the run folder of every trial, and the best settings so far
as a file that ``train --config`` takes. Trials of a low score are pruned: those whose best score
so far is below the median of the others' after as many evaluations. Trials that are drawn together,
and the seeds of a trial, may be trained side by side; the same comes out wherever they are.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amusic_agents.config import TrainingConfig, leaves, with_leaves
from amusic_agents.evaluation import Evaluation
from amusic_agents.training import train
from amusic_agents.trials import Learn, Learner, Reached, Training, load_optuna
from amusic_gym.extraction.executors import make_executor
from amusic_gym.extraction.shards import Workers
from amusic_gym.utils.checks import whole
from amusic_gym.utils.storage import only_writer, write_whole

if TYPE_CHECKING:
    import optuna

JOURNAL, BEST, TRIALS = "journal.log", "best.json", "trials"
NAME = "amusic"

JUDGING = ("seed", "timesteps", "threads", "evaluate_every", "held_out", "highest_weight")
"""Settings that are no part of a search: they decide how long, on what and how well is measured."""


@dataclass(frozen=True)
class Range:
    """Numbers to search in, on a logarithmic scale if ``log``."""

    low: float
    high: float
    log: bool = False


Space = Mapping[str, Range | tuple[Any, ...]]
"""Name of a setting, as of `leaves` → a range, or the values to choose from."""

_PPO: Space = {
    "learning_rate": Range(1e-4, 3e-3, log=True),
    "entropy": Range(1e-4, 0.05, log=True),
    "reward_discount": (0.8, 0.9, 0.95, 0.98, 0.99),
    "gae_lambda": Range(0.7, 1.0),
    "n_steps": (32, 64, 128),
    "epochs": Range(1, 10),
}
SPACES: dict[str, Space] = {
    "ppo": {**_PPO, "network.hidden": (32, 64, 128)},
    "reselect": _PPO,
    "imitation": {
        "imitation.learning_rate": Range(1e-3, 1e-2, log=True),
        "imitation.teacher_share": Range(0.2, 0.9),
        "imitation.epochs": Range(2, 8),
        "network.hidden": (32, 64, 128),
    },
    "imitation+ppo": {**_PPO, "frozen_updates": Range(0, 16)},
    "rollouts": {
        "rollouts.learning_rate": Range(5e-4, 1e-2, log=True),
        "rollouts.discount": Range(0.95, 0.995),
        "rollouts.hold": Range(1, 16),
        "rollouts.horizon": Range(30, 120),
        "rollouts.share": Range(0.4, 1.0),
    },
}
"""What is searched, by algorithm, where nothing else is asked for."""


class Study:
    """A study in its folder, new or as it was left.

    ``about`` are settings, space, banks and seeds of a new one, as JSON has them; None: as stored.

    Raises:
        ValueError: if Optuna is missing, the folder holds another study or none, or is damaged.
    """

    def __init__(self, out: Path, about: Mapping[str, Any] | None = None) -> None:
        optuna = load_optuna()
        self.out = out
        path = out / JOURNAL
        if about is None and not path.exists():
            raise ValueError(f"{out} holds no study; leave out resume to begin one")
        if about is not None and path.exists():
            raise ValueError(f"{out} holds a study already; resume it or give another folder")
        try:
            backend = optuna.storages.journal.JournalFileBackend(str(path))
            storage = optuna.storages.JournalStorage(backend)
            named = {"study_name": NAME, "storage": storage}
            if about is None:
                self.study = optuna.load_study(**named)
            else:
                self.study = optuna.create_study(direction="maximize", **named)
                for name, value in about.items():
                    self.study.set_user_attr(name, value)
            stored = self.study.user_attrs
            self.base: TrainingConfig = with_leaves(TrainingConfig(), stored["settings"])
            self.space = {
                name: Range(**one) if isinstance(one, dict) else tuple(one)
                for name, one in stored["space"].items()
            }
            self.banks: list[str] = list(stored["banks"])
            self.seeds = int(stored.get("seeds", 1))
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is damaged ({error}); give another folder") from error
        # Other draws than before, but the same after every resume from here.
        seed = self.base.seed + len(self.study.trials)
        self.study.sampler = optuna.samplers.TPESampler(seed=seed)

    @property
    def finished(self) -> list[optuna.trial.FrozenTrial]:
        """Trials that were trained to their end or pruned."""
        return [trial for trial in self.study.trials if trial.state.name in ("COMPLETE", "PRUNED")]

    @property
    def completed(self) -> list[optuna.trial.FrozenTrial]:
        """Trials that were trained to their end."""
        return [trial for trial in self.study.trials if trial.state.name == "COMPLETE"]

    @property
    def best(self) -> optuna.trial.FrozenTrial | None:
        """The trial of the highest score, of those trained to their end."""
        return max(self.completed, key=lambda trial: trial.value or 0.0, default=None)

    def requeue(self) -> None:
        """Put trials that a stop interrupted before the next ones; they go on in their folders."""
        for trial in self.study.trials:
            if trial.state.name == "RUNNING":
                if trial.params:
                    self.study.enqueue_trial(trial.params, user_attrs=trial.user_attrs)
                self.study.tell(trial.number, state=load_optuna().trial.TrialState.FAIL)

    def settings(self, trial: optuna.Trial | optuna.trial.FrozenTrial) -> TrainingConfig:
        """The configuration of a trial."""
        defaults = leaves(self.base)
        values = {name: _draw(trial, name, of, defaults[name]) for name, of in self.space.items()}
        return with_leaves(self.base, values)

    def run_round(self, count: int, workers: Workers) -> list[optuna.trial.FrozenTrial]:
        """Draw settings of ``count`` trials, train with them, and keep what they reached."""
        trials = [self.study.ask() for _ in range(count)]
        drawn = [self.settings(trial) for trial in trials]  # before any is trained: a stop keeps it
        trainings = [
            training
            for trial, config in zip(trials, drawn, strict=True)
            for training in self._trainings(trial, config)
        ]
        reached: dict[int, list[Reached]] = {trial.number: [] for trial in trials}
        found = {training.folder: each for training, each in workers.run(trainings)}
        for training in trainings:  # not in the order in which they ended
            reached[training.trial].append(found[training.folder])
        return [self._tell(trial, reached[trial.number]) for trial in trials]

    def _trainings(self, trial: optuna.Trial, config: TrainingConfig) -> list[Training]:
        """A trial's trainings; the only one is pruned, several are not."""
        if "run" not in trial.user_attrs:
            trial.set_user_attr("run", f"{trial.number:04d}")
        run = self.out / TRIALS / trial.user_attrs["run"]
        if self.seeds == 1:
            scores = tuple(tuple(each.intermediate_values.values()) for each in self.completed)
            return [Training(trial.number, run, config, scores)]
        seeds = range(config.seed, config.seed + self.seeds)
        return [
            Training(trial.number, run / f"seed-{seed}", replace(config, seed=seed))
            for seed in seeds
        ]

    def _tell(self, trial: optuna.Trial, reached: Sequence[Reached]) -> optuna.trial.FrozenTrial:
        """Keep a trial's scores, means over its seeds, and the best settings so far."""
        curves = [one.scores for one in reached]
        scores = [sum(each) / len(each) for each in zip(*curves, strict=False)]
        for number, score in enumerate(scores, 1):
            trial.report(score, number)
        if any(one.pruned for one in reached):
            state = load_optuna().trial.TrialState.PRUNED
            told = self.study.tell(trial, state=state)
        else:
            told = self.study.tell(trial, max(scores))
        if self.best is not None:
            best = json.dumps(asdict(self.settings(self.best)), indent=1)
            write_whole(self.out / BEST, f"{best}\n".encode())
        return told


def tune(
    out: str | Path,
    config: TrainingConfig | None,
    *,
    trials: int,
    space: Space | None = None,
    banks: Sequence[str] = (),
    seeds: int = 1,
    at_once: int = 1,
    executor: str = "serial",
    learn: Callable[..., Learn] | None = None,
    report: Callable[[str], object] = print,
) -> TrainingConfig:
    """Search for the settings that reach the highest held-out score.

    Args:
        out: the study folder; no other process writes to it meanwhile.
        config: what every trial has but for what is searched; None: go on with the folder's study.
        trials: how many are finished in the end, pruned ones among them.
        space: what is searched; None: `SPACES` of the algorithm. Of a new study.
        banks: folders of banks to train on; none: simulated routes. Of a new study.
        seeds: trainings of a trial, from the seed of ``config`` on. With several the mean of their
            scores counts, and none is pruned. Of a new study.
        at_once: trials that are drawn and judged together, knowing nothing of each other.
        executor: ``serial``, ``process:N``, ``ray`` or ``ray:ADDRESS``; no part of the result.
        learn: makes what trains from the study's banks, and whether a bar is shown; None: `train`,
            without a teacher.
        report: called with a line for every trial.

    Returns:
        The best configuration.

    Raises:
        ValueError: if Optuna is missing, for settings that cannot be searched, for a folder in use
            or with another study, for an unknown executor; also what a training refuses.
        ChildProcessError: when workers die of the same training again and again.
        KeyboardInterrupt: when stopped; the study goes on with the trial that was stopped.
    """
    out = Path(out)
    about: dict[str, Any] | None = None
    if config is not None:
        space = SPACES[config.algorithm] if space is None else space
        check_space(space, config)
        plain = {n: asdict(s) if isinstance(s, Range) else list(s) for n, s in space.items()}
        about = {"settings": leaves(config), "space": plain, "banks": [str(b) for b in banks]}
        about["seeds"] = whole("seeds", seeds, 1)
    whole("trials", trials, 1)
    whole("at_once", at_once, 1)
    load_optuna()
    where = make_executor(executor)
    with only_writer(out), where:
        study = Study(out, about)
        study.requeue()
        learner = Learner((learn or _trainer)(study.banks, executor == "serial"))
        with where.workers(learner) as workers:
            while (left := trials - len(study.finished)) > 0:
                for trial in study.run_round(min(at_once, left), workers):
                    report(_line(trial, study.best))
        if study.best is None:
            raise ValueError(f"no trial of {out} came to its end; give more than {trials} trials")
        return study.settings(study.best)


def check_space(space: Space, config: TrainingConfig) -> None:
    """Refuse the first setting that cannot be searched, or that no training would take."""
    known = leaves(config)
    if not space:
        raise ValueError("there is nothing to search; give at least one setting")
    for name, of in space.items():
        if isinstance(known.get(name), bool) or not isinstance(known.get(name), int | float):
            raise ValueError(f"{name} is no number of a training's settings; leave it out")
        if name in JUDGING:
            raise ValueError(f"{name} decides how trials are judged; leave it out")
        if isinstance(of, Range) and not (of.low <= of.high and (of.low > 0 or not of.log)):
            raise ValueError(
                f"{name} from {of.low} to {of.high}; give LOW <= HIGH, 0 < LOW for log"
            )
        for value in (of.low, of.high) if isinstance(of, Range) else of:
            with_leaves(config, {name: value})


def _draw(trial: Any, name: str, of: Range | tuple[Any, ...], default: Any) -> Any:
    """The value of a setting in a trial."""
    if not isinstance(of, Range):
        return trial.suggest_categorical(name, of)
    suggest = trial.suggest_int if isinstance(default, int) else trial.suggest_float
    return suggest(name, of.low, of.high, log=of.log)


def _trainer(banks: Sequence[str], progress: bool) -> Learn:
    return partial(_train, tuple(banks), progress)


def _train(
    banks: Sequence[str],
    progress: bool,
    out: Path,
    config: TrainingConfig,
    resume: bool,
    evaluated: Callable[[Evaluation], None],
) -> None:
    train(out, config, banks=banks, resume=resume, evaluated=evaluated, progress=progress)


def _line(trial: optuna.trial.FrozenTrial, best: optuna.trial.FrozenTrial | None) -> str:
    scores = list(trial.intermediate_values.values())
    what = f"pruned after {len(scores)} evaluations," if trial.state.name == "PRUNED" else "score"
    params = " ".join(f"{n}={v:g}" for n, v in trial.params.items())
    reached = "" if best is None else f"; best {best.value:.4f}, trial {best.number}"
    return f"trial {trial.number}: {what} {max(scores):.4f}{reached}  {params}"
