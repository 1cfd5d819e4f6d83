"""Training a selector with PPO (Stable-Baselines3): evaluation, checkpoints, resume."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from agents.adapter import SB3VecEnv
from agents.evaluation import Evaluation, HeldOut
from agents.network import NetworkConfig, SelectorNetwork, SelectorPolicy
from agents.run_folder import (
    CHECKPOINT,
    Tensors,
    read_config,
    read_tensors,
    versions,
    write_config,
    write_selector,
    write_tensors,
)
from agents.selector import TrainedSelector
from amusic_gym import __version__
from amusic_gym.bank import ScoreBank
from amusic_gym.settings import SICSettings
from amusic_gym.sources import Banks, RouteSource, SimulatedRoutes
from amusic_gym.vector_env import TechniqueSelectionVectorEnv

TRAINING_SEED = 1_000_000
"""First seed of the training routes; held-out routes have another."""


@dataclass(frozen=True)
class TrainingConfig:
    """Everything that decides how a selector is trained; the defaults are those of ``train.py``.

    Attributes:
        timesteps: frames in all, over all routes.
        seed: of routes, weights and draws.
        n_envs: routes side by side.
        statistic: SIC's statistic.
        compute_weights: range from which every episode draws λ, on a logarithmic scale.
        pool: simulated training routes that are drawn from again and again.
        n_steps: frames per route between two updates.
        batch_size: frames per gradient step.
        epochs: passes over the frames of an update.
        learning_rate: at the start; falls linearly to zero.
        discount: of later rewards, per frame.
        gae_lambda: of the generalised advantage estimate.
        entropy: weight of the entropy bonus.
        evaluate_every: frames between two evaluations, each followed by a checkpoint.
        held_out: simulated routes of an evaluation.
        network: sizes of the network.
    """

    timesteps: int = 1_000_000
    seed: int = 0
    n_envs: int = 64
    statistic: str = SICSettings.statistic
    compute_weights: tuple[float, float] = (0.03, 4.0)
    pool: int = 256
    n_steps: int = 64
    batch_size: int = 1024
    epochs: int = 4
    learning_rate: float = 1e-3
    discount: float = 0.95
    gae_lambda: float = 0.9
    entropy: float = 0.003
    evaluate_every: int = 200_000
    held_out: int = 16
    network: NetworkConfig = field(default_factory=NetworkConfig)

    def __post_init__(self) -> None:
        for name in ("timesteps", "n_envs", "pool", "n_steps", "batch_size", "epochs"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; give at least 1")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; give a whole number >= 0")


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
        batch_size=min(config.batch_size, config.n_steps * config.n_envs),
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
    banks: Sequence[str | Path | ScoreBank] = (),
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
        resume: go on from the folder's last checkpoint.
        progress: whether to show a progress bar.

    Returns:
        The best selector by evaluation on held-out simulated routes.

    Raises:
        ValueError: if the folder holds another training, or there is nothing to resume.
        KeyboardInterrupt: after saving a checkpoint.
    """
    out = Path(out)
    if resume:
        config = replace(stored_config(out), timesteps=config.timesteps)
    elif (out / CHECKPOINT).exists():
        raise ValueError(f"{out} holds a training already; resume it or give another folder")
    out.mkdir(parents=True, exist_ok=True)
    routes = source or _source(config, banks)
    model = make_model(config, routes)
    model.set_logger(configure(str(out), ["csv", "tensorboard"]))
    keeper = _Keeper(out, config, HeldOut(config.held_out, config.statistic))
    if resume:
        keeper.restore(model)
    else:
        write_config(out, stored(config, best=None))
    left = config.timesteps - model.num_timesteps
    try:
        if left > 0:
            model.learn(
                left, callback=keeper, reset_num_timesteps=False, progress_bar=progress
            )
        keeper.evaluate()
    except KeyboardInterrupt:
        keeper.checkpoint()
        raise
    finally:
        model.logger.close()
    from agents.selector import load_selector

    return load_selector(out)


def _source(config: TrainingConfig, banks: Sequence[str | Path | ScoreBank]) -> RouteSource:
    if banks:
        return Banks(list(banks), aligned=False)
    seed = TRAINING_SEED + config.seed
    return SimulatedRoutes(pool=config.pool, seed=seed, keep=config.pool)


def stored(config: TrainingConfig, best: Evaluation | None) -> dict[str, Any]:
    """What ``config.json`` holds."""
    return {
        "versions": versions(config.statistic),
        "amusic_gym": __version__,
        "environment": {},
        "training": asdict(config),
        "best": None if best is None else best._asdict(),
    }


def stored_config(out: Path) -> TrainingConfig:
    """The configuration of a run folder.

    Raises:
        FileNotFoundError: if there is no run.
        ValueError: if it is of another version.
    """
    values = dict(read_config(out)["training"])
    values["network"] = NetworkConfig(**values["network"])
    values["compute_weights"] = tuple(values["compute_weights"])
    return TrainingConfig(**values)


class _Keeper(BaseCallback):
    """Evaluates, keeps the best, writes checkpoints."""

    def __init__(self, out: Path, config: TrainingConfig, held_out: HeldOut) -> None:
        super().__init__()
        self.out = out
        self.config = config
        self.held_out = held_out
        self.best: Evaluation | None = None
        self._next = config.evaluate_every

    @property
    def network(self) -> SelectorNetwork:
        network = self.model.policy.mlp_extractor
        assert isinstance(network, SelectorNetwork)
        return network

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps >= self._next:
            self.evaluate()

    def evaluate(self) -> None:
        """Evaluate, keep the selector if it is the best, write a checkpoint."""
        steps = self.model.num_timesteps
        self._next = steps + self.config.evaluate_every
        selector = TrainedSelector(self.network, self.config.statistic)
        result = self.held_out.evaluate(selector, steps)
        for name, value in result._asdict().items():
            self.model.logger.record(f"held_out/{name}", value)
        self._note(result)
        if self.best is None or result.score > self.best.score:
            self.best = result
            write_selector(self.out, self.network, self.config.network)
            write_config(self.out, stored(self.config, self.best))
        self.checkpoint()

    def _note(self, result: Evaluation) -> None:
        path = self.out / "evaluation.csv"
        new = not path.exists()
        with path.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(result._fields)
            writer.writerow(result)

    def checkpoint(self) -> None:
        """Write everything that resuming needs, as one file."""
        model = self.model
        tensors: Tensors = {f"policy.{k}": v for k, v in model.policy.state_dict().items()}
        optimiser = model.policy.optimizer.state_dict()["state"]
        for index, values in optimiser.items():
            tensors |= {f"optimiser.{index}.{k}": torch.as_tensor(v) for k, v in values.items()}
        tensors["random.torch"] = torch.get_rng_state()
        metadata = {
            "timesteps": str(model.num_timesteps),
            "updates": str(model._n_updates),
            "numpy": json.dumps(_numpy_state()),
            "best": json.dumps(None if self.best is None else self.best._asdict()),
        }
        write_tensors(self.out / CHECKPOINT, tensors, metadata)

    def restore(self, model: PPO) -> None:
        """Take a model back to the last checkpoint; its routes begin anew."""
        tensors, metadata = read_tensors(self.out / CHECKPOINT)
        model.policy.load_state_dict(_part(tensors, "policy."))
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, tensor in _part(tensors, "optimiser.").items():
            index, _, key = name.partition(".")
            state.setdefault(int(index), {})[key] = tensor
        optimiser = model.policy.optimizer.state_dict()
        model.policy.optimizer.load_state_dict({**optimiser, "state": state})
        model.num_timesteps = int(metadata["timesteps"])
        model._n_updates = int(metadata["updates"])
        best = json.loads(metadata["best"])
        self.best = None if best is None else Evaluation(**best)
        self._next = model.num_timesteps + self.config.evaluate_every
        assert model.env is not None
        # Other routes than those already driven, but the same after every resume from here.
        model.env.seed(self.config.seed + model.num_timesteps)
        torch.set_rng_state(tensors["random.torch"])
        name, keys, *rest = json.loads(metadata["numpy"])
        np.random.set_state((name, np.array(keys, np.uint32), *rest))


def _part(tensors: Tensors, prefix: str) -> Tensors:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def _numpy_state() -> list[Any]:
    name, keys, *rest = np.random.get_state(legacy=True)
    return [name, np.asarray(keys).tolist(), *rest]
