"""Training a selector from rewards (Stable-Baselines3): evaluation, checkpoints, resume."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, ProgressBarCallback
from stable_baselines3.common.logger import Logger, make_output_format

from amusic_agents.config import TrainingConfig, stored_banks, stored_config
from amusic_agents.evaluation import HeldOut
from amusic_agents.keeper import Keeper
from amusic_agents.learners import learner
from amusic_agents.run_folder import CHECKPOINT, SELECTOR, read_config
from amusic_agents.selector import load_selector
from amusic_agents.warm_start import FreezeActor, Start, starting_network, take_over
from amusic_gym.banks.bank_files import refuse_within_bank
from amusic_gym.envs.sources import BankLike, Banks, RouteSource, SimulatedRoutes
from amusic_gym.policies.protocol import Selector
from amusic_gym.utils.storage import only_writer

TRAINING_SEED = 1_000_000
"""First seed of the training routes; held-out routes have another."""


def make_model(config: TrainingConfig, source: RouteSource) -> BaseAlgorithm:
    """The configuration's algorithm on the native vector environment, on one thread, seeded."""
    return learner(config.algorithm).make_model(config, source)


def train(
    out: str | Path,
    config: TrainingConfig,
    *,
    banks: Sequence[BankLike] = (),
    source: RouteSource | None = None,
    resume: bool = False,
    progress: bool = True,
    warm_start: Start | None = None,
) -> Selector:
    """Train a selector and keep the best in a run folder.

    Args:
        out: the run folder.
        config: how.
        banks: banks to train on; none: simulated routes.
        source: routes to train on, instead of banks or the default simulation.
        resume: go on from the folder's last checkpoint, with its configuration and banks; of
            ``config`` only ``timesteps`` counts then.
        progress: whether to show a progress bar.
        warm_start: network, or run folder of an imitation or of PPO, whose weights PPO begins
            from; they are evaluated first, and so stay the best until others are better. With
            ``config.frozen_updates`` the critic learns alone at first.

    Returns:
        The best selector by evaluation on held-out simulated routes.

    Raises:
        FileNotFoundError: if there is nothing to resume, or a bank is missing.
        ValueError: if the folder holds another training or is damaged, or the warm start is of
            another network or statistic.
        KeyboardInterrupt: after saving a checkpoint.
    """
    out = Path(out)
    timesteps = config.timesteps
    with begun(out, config, banks, source, resume) as (config, banks):
        if resume:
            config = replace(config, timesteps=timesteps)
        else:
            config = replace(config, warm_start=_folder(warm_start))
        model = make_model(config, source or training_source(config, banks))
        held_out = HeldOut(config.held_out, config.statistic)
        keeper = Keeper(out, config, bank_folders(source, banks), held_out)
        keeper.init_callback(model)
        if resume:
            _go_on(keeper)
        else:
            if warm_start is not None:
                take_over(model, starting_network(warm_start, config))
            keeper.begin()
        model.set_logger(_logger(out, model.num_timesteps))
        try:
            if model.num_timesteps == 0 and (warm_start or config.warm_start):
                keeper.evaluate()
            left = config.timesteps - model.num_timesteps
            if left > 0:
                _learn(model, left, keeper, progress)
            keeper.finish()
        except KeyboardInterrupt:
            keeper.save()
            raise
        finally:
            model.logger.close()
        return load_selector(out)


def _go_on(keeper: Keeper) -> None:
    """Restore the last checkpoint, and refuse what is finished."""
    keeper.restore()
    done, wanted = keeper.model.num_timesteps, keeper.config.timesteps
    if wanted + keeper.config.rollout <= done:  # more than the overshoot
        raise ValueError(
            f"{keeper.out} has {done} frames of training already; give more timesteps"
            f" than {wanted} to go on"
        )
    keeper.records.write()


def _learn(model: BaseAlgorithm, timesteps: int, keeper: Keeper, progress: bool) -> None:
    callbacks: list[BaseCallback] = [keeper]
    if keeper.config.frozen_updates:
        callbacks.append(FreezeActor(keeper.config.frozen_updates, keeper.config.rollout))
    bars = [ProgressBarCallback()] if progress else []
    try:
        model.learn(timesteps, callback=[*callbacks, *bars], reset_num_timesteps=False)
    finally:
        for bar in bars:  # an interrupted one would go on moving, and hide the cursor
            if hasattr(bar, "pbar"):
                bar.pbar.close()


@contextmanager
def begun(
    out: Path,
    config: TrainingConfig,
    banks: Sequence[BankLike],
    source: RouteSource | None,
    resume: bool,
) -> Iterator[tuple[TrainingConfig, Sequence[BankLike]]]:
    """The configuration and banks of a run: those of its folder to resume, else those given.

    No other process trains in the folder meanwhile.

    Args:
        out: the run folder; a used one is refused unless it is to be resumed.
        config: what is given.
        banks: banks given to train on.
        source: routes given instead of banks.
        resume: whether the folder's training goes on.

    Raises:
        FileNotFoundError: if there is nothing to resume.
        ValueError: if the folder is in use, in that of a bank, damaged, or holds another training.
    """
    (read_config if resume else refuse_used)(out)  # before a folder is made
    with only_writer(out):
        if resume:
            yield stored_config(out), banks if banks or source else stored_banks(out)
        else:
            refuse_used(out)
            yield config, banks


def refuse_used(out: Path) -> None:
    """Refuse a folder that holds a training already, or that is in the folder of a bank.

    Raises:
        ValueError: naming the file, or the bank.
    """
    refuse_within_bank(out)
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is a file; give a folder")
    for name in (CHECKPOINT, SELECTOR):
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


def bank_folders(source: RouteSource | None, banks: Sequence[BankLike]) -> list[str | None]:
    """Folders of the banks, as a run folder notes them; None for what is only in memory."""
    return [None] if source else [_folder(bank) for bank in banks]


def _folder(bank: object) -> str | None:
    """A bank's folder, None for a live route and for a bank that is only in memory."""
    path = bank if isinstance(bank, str | os.PathLike) else getattr(bank, "path", None)
    return None if path is None else os.path.abspath(path)


def _logger(out: Path, timesteps: int) -> Logger:
    """Curves as CSV and for TensorBoard; those before a resume stay as they are."""
    suffix = f"-{timesteps}" if timesteps else ""
    kinds = ("csv", "tensorboard")
    return Logger(str(out), [make_output_format(kind, str(out), suffix) for kind in kinds])


__all__ = ["TrainingConfig", "make_model", "train"]
