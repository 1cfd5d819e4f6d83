"""Training a selector: where a run begins or goes on, whatever the algorithm."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from inspect import signature
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from amusic_agents.config import ALGORITHMS, TrainingConfig
from amusic_agents.evaluation import Evaluation
from amusic_agents.network import NetworkSelector
from amusic_agents.records import Records
from amusic_agents.run_folder import (
    CHECKPOINT,
    CONFIG,
    SELECTOR,
    read_config,
    stored_banks,
    stored_config,
)
from amusic_agents.selector import load_selector
from amusic_gym.banks.bank_files import refuse_within_bank
from amusic_gym.envs.sources import BankLike, Banks, RouteSource, SimulatedRoutes
from amusic_gym.policies.protocol import Selector
from amusic_gym.utils.storage import only_writer

if TYPE_CHECKING:
    from stable_baselines3.common.callbacks import BaseCallback

TRAINING_SEED = 1_000_000  # first seed of the training routes; held-out routes have another
IMITATION = "imitation"  # folder of the imitation within a run that goes on with PPO


def train(
    out: str | Path,
    config: TrainingConfig,
    *,
    banks: Sequence[BankLike] = (),
    source: RouteSource | None = None,
    teacher: Selector | None = None,
    callbacks: Sequence[BaseCallback] = (),
    evaluated: Callable[[Evaluation], object] | None = None,
    resume: bool = False,
    progress: bool = True,
) -> NetworkSelector:
    """Train a selector and keep the best in a run folder.

    Args:
        out: the run folder; no other process trains in it meanwhile.
        config: how.
        banks: banks to train on; none: simulated routes.
        source: routes to train on, instead of banks or the default simulation.
        teacher: says what to do in an imitation, also on routes that the student drives; one that
            reads ``info["compute_weight"]``, as :class:`amusic_agents.teachers.ByWeight` does,
            teaches every λ.
        callbacks: of Stable-Baselines3, for the algorithms that use its PPO.
        evaluated: called with every evaluation once it is kept, those before a resume first; what
            it raises ends the training. Those of the imitation before a PPO are left out.
        resume: go on from the folder's last checkpoint, with its configuration and banks; of
            ``config`` only ``timesteps`` and ``threads`` count then. A finished imitation or
            policy iteration is returned as it is; both go on with the same result as without a
            stop.
        progress: whether to show a progress bar.

    Returns:
        The best selector by evaluation on held-out simulated routes.

    Raises:
        FileNotFoundError: if there is nothing to resume, or a bank is missing.
        ValueError: if the folder is in use, in that of a bank, damaged, or holds another training;
            if an algorithm has no use for the routes, the teacher or the callbacks.
        KeyboardInterrupt: after saving a checkpoint, with PPO.
    """
    out = Path(out)
    (read_config if resume else refuse_used)(out)  # before a folder is made
    with only_writer(out):
        if resume:
            config = replace(stored_config(out), timesteps=config.timesteps, threads=config.threads)
            banks = banks if banks or source else stored_banks(out)
        else:
            refuse_used(out)
        learner_type: Any = resolve_name(ALGORITHMS[config.algorithm])
        accepted = signature(learner_type).parameters
        if callbacks and "callbacks" not in accepted:
            raise ValueError(
                f"algorithm {config.algorithm!r} takes no callbacks of Stable-Baselines3; leave"
                " them out"
            )
        folders = [None] if source else [_folder(bank) for bank in banks]
        records = Records(out, config, folders, learner_type.kind, evaluated)
        begun = (out / CHECKPOINT).exists()
        start = None
        if config.algorithm == "imitation+ppo" and not begun:
            records.write()
            start = out / IMITATION
            train(
                start,
                replace(config, algorithm="imitation"),
                banks=banks,
                source=source,
                teacher=teacher,
                resume=(start / CONFIG).exists(),
                progress=progress,
            )
        given = {"teacher": teacher, "callbacks": callbacks, "start": start}
        learner = learner_type(
            config,
            source or training_source(config, banks),
            records,
            **{name: value for name, value in given.items() if name in accepted},
        )
        if begun:
            learner.restore()
        records.write()
        learner.run(progress)
        return load_selector(out)


def refuse_used(out: Path) -> None:
    """Refuse a folder that holds a training already, or that is in the folder of a bank."""
    refuse_within_bank(out)
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is a file; give a folder")
    for name in (CHECKPOINT, SELECTOR, f"{IMITATION}/{CHECKPOINT}"):
        if (out / name).exists():
            raise ValueError(
                f"{out} holds a training already ({name}); resume it or give another folder"
            )


def training_source(config: TrainingConfig, banks: Sequence[BankLike] = ()) -> RouteSource:
    """The given banks, or the simulated routes of the configuration's seed."""
    return Banks(list(banks), aligned=False) if banks else simulated_routes(config)


def simulated_routes(config: TrainingConfig) -> SimulatedRoutes:
    """The simulated routes of the configuration's seed; no evaluation uses them."""
    seed = TRAINING_SEED + config.seed
    return SimulatedRoutes(config.population(), pool=config.pool, seed=seed, keep=config.pool)


def _folder(bank: object) -> str | None:
    """A bank's folder, None for a live route and for a bank that is only in memory."""
    path = bank if isinstance(bank, str | os.PathLike) else getattr(bank, "path", None)
    return None if path is None else os.path.abspath(path)


__all__ = ["TrainingConfig", "train"]
