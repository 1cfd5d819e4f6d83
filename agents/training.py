"""Training a selector with PPO (Stable-Baselines3): evaluation, checkpoints, resume."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import ProgressBarCallback
from stable_baselines3.common.logger import Logger, make_output_format

from agents.adapter import SB3VecEnv
from agents.config import TrainingConfig, stored_banks, stored_config
from agents.evaluation import HeldOut
from agents.keeper import Keeper
from agents.network import SelectorPolicy
from agents.run_folder import CHECKPOINT, SELECTOR
from agents.selector import TrainedSelector, load_selector
from amusic_gym.sources import BankLike, Banks, RouteSource, SimulatedRoutes
from amusic_gym.vector_env import TechniqueSelectionVectorEnv

TRAINING_SEED = 1_000_000
"""First seed of the training routes; held-out routes have another."""


def make_model(config: TrainingConfig, source: RouteSource) -> PPO:
    """PPO on the native vector environment, on one thread, seeded."""
    torch.set_num_threads(1)  # small batches: more threads only wait for each other
    env = TechniqueSelectionVectorEnv(
        config.n_envs,
        source,
        slots=source.slots,
        statistic=config.statistic,
        compute_weight=config.compute_weights,
        autoreset_mode="SameStep",
    )
    return PPO(
        SelectorPolicy,
        SB3VecEnv(env),
        policy_kwargs={"config": config.network},
        n_steps=config.n_steps,
        batch_size=config.batch,
        n_epochs=config.epochs,
        learning_rate=lambda left: config.learning_rate * left,
        gamma=config.discount,
        gae_lambda=config.gae_lambda,
        ent_coef=config.entropy,
        seed=config.seed,
        device="cpu",
    )


def train(
    out: str | Path,
    config: TrainingConfig,
    *,
    banks: Sequence[BankLike] = (),
    source: RouteSource | None = None,
    resume: bool = False,
    progress: bool = True,
) -> TrainedSelector:
    """Train a selector and keep the best in a run folder.

    Args:
        out: the run folder.
        config: how.
        banks: banks to train on; none: simulated routes.
        source: routes to train on, instead of banks or the default simulation.
        resume: go on from the folder's last checkpoint, with its configuration and banks; of
            ``config`` only ``timesteps`` counts then.
        progress: whether to show a progress bar.

    Returns:
        The best selector by evaluation on held-out simulated routes.

    Raises:
        FileNotFoundError: if there is nothing to resume, or a bank is missing.
        ValueError: if the folder holds another training or is damaged.
        KeyboardInterrupt: after saving a checkpoint.
    """
    out = Path(out)
    if resume:
        config = replace(stored_config(out), timesteps=config.timesteps)
        banks = banks if banks or source else stored_banks(out)
    else:
        _refuse_used(out)
    model = make_model(config, source or _source(config, banks))
    names = [None] if source else [_folder(bank) for bank in banks]
    keeper = Keeper(out, config, names, HeldOut(config.held_out, config.statistic))
    keeper.init_callback(model)
    if resume:
        keeper.restore()
        if config.timesteps + config.rollout <= model.num_timesteps:  # more than the overshoot
            raise ValueError(
                f"{out} has {model.num_timesteps} frames of training already; give more timesteps"
                f" than {config.timesteps} to go on"
            )
        keeper.write_records()
    else:
        keeper.begin()
    model.set_logger(_logger(out, model.num_timesteps))
    try:
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


def _learn(model: PPO, timesteps: int, keeper: Keeper, progress: bool) -> None:
    bars = [ProgressBarCallback()] if progress else []
    try:
        model.learn(timesteps, callback=[keeper, *bars], reset_num_timesteps=False)
    finally:
        for bar in bars:  # an interrupted one would go on moving, and hide the cursor
            if hasattr(bar, "pbar"):
                bar.pbar.close()


def _refuse_used(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is a file; give a folder")
    for name in (CHECKPOINT, SELECTOR):
        if (out / name).exists():
            raise ValueError(
                f"{out} holds a training already ({name}); resume it or give another folder"
            )


def _source(config: TrainingConfig, banks: Sequence[BankLike]) -> RouteSource:
    if banks:
        return Banks(list(banks), aligned=False)
    seed = TRAINING_SEED + config.seed
    return SimulatedRoutes(pool=config.pool, seed=seed, keep=config.pool)


def _folder(bank: BankLike) -> str | None:
    """A bank's folder, None for a live route and for a bank that is only in memory."""
    path = bank if isinstance(bank, str | os.PathLike) else getattr(bank, "path", None)
    return None if path is None else os.path.abspath(path)


def _logger(out: Path, timesteps: int) -> Logger:
    """Curves as CSV and for TensorBoard; those before a resume stay as they are."""
    suffix = f"-{timesteps}" if timesteps else ""
    kinds = ("csv", "tensorboard")
    return Logger(str(out), [make_output_format(kind, str(out), suffix) for kind in kinds])


__all__ = ["TrainingConfig", "make_model", "train"]
