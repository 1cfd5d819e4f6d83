"""What happens beside the learning: evaluations, the best selector, checkpoints, resume."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from amusic_agents.config import TrainingConfig, stored
from amusic_agents.evaluation import Evaluation, HeldOut
from amusic_agents.learners import kind as kind_of
from amusic_agents.learners import learner
from amusic_agents.run_folder import (
    BEST,
    CHECKPOINT,
    EVALUATIONS,
    SELECTOR,
    Tensors,
    check_layers,
    part,
    read_list,
    read_selector,
    read_tensors,
    write_config,
    write_selector,
    write_tensors,
)
from amusic_gym.policies.protocol import Selector
from amusic_gym.utils.checks import number, whole
from amusic_gym.utils.escaping import CsvWriter
from amusic_gym.utils.storage import write_whole


class Records:
    """A run folder's configuration, evaluations and best selector.

    The checkpoint holds the evaluations and the best selector too, and is written first: when a
    training that was killed between two files is resumed, all of them are again of one moment.

    Args:
        out: the run folder.
        config: the training's configuration.
        banks: folders of the banks, for ``config.json``.
        kind: what kind of selector is trained, a name out of `amusic_agents.learners.KINDS`.
        sizes: dataclass of its network's sizes.
    """

    def __init__(
        self, out: Path, config: TrainingConfig, banks: Sequence[str | None], kind: str, sizes: Any
    ) -> None:
        self.out = out
        self.config = config
        self.banks = banks
        self.kind = kind
        self.sizes = sizes
        self.evaluations: list[Evaluation] = []
        self.network: nn.Module | None = None  # the best
        self._stored: Evaluation | None = None  # of the selector on disk

    @property
    def best(self) -> Evaluation | None:
        """The first of the highest score."""
        return max(self.evaluations, key=lambda result: result.score, default=None)

    def policy(self, network: nn.Module) -> Selector:
        """The policy around a network."""
        return kind_of(self.kind).selector(
            network, self.config.statistic, self.config.environment()
        )

    def add(self, result: Evaluation, network: nn.Module) -> None:
        """Note an evaluation, and a copy of the network if it is the best."""
        if self.best is None or result.score > self.best.score:
            self.network = deepcopy(network)
        self.evaluations.append(result)

    def checkpoint(self) -> tuple[Tensors, dict[str, str]]:
        """Tensors and metadata of a checkpoint that :meth:`restore` needs."""
        weights = {} if self.network is None else self.network.state_dict()
        tensors = {f"{BEST}{name}": tensor for name, tensor in weights.items()}
        return tensors, {"evaluations": json.dumps(self.evaluations)}

    def restore(self, path: Path, tensors: Tensors, metadata: dict[str, str]) -> None:
        """Take from a checkpoint what :meth:`checkpoint` gave it.

        Raises:
            KeyError, TypeError, ValueError: for a damaged one, or a damaged selector.
        """
        if (self.out / SELECTOR).exists():
            read_selector(self.out)
        rows = [Evaluation(*row) for row in read_list(path, metadata, "evaluations")]
        for row in rows:
            whole("timesteps", row.timesteps, 0)
            for name, value in row._asdict().items():
                number(name, value, "a number")
        self.evaluations = rows
        weights = part(tensors, BEST)
        if weights:
            self.network = kind_of(self.kind).network(self.sizes)
            check_layers(path, weights, self.network.state_dict())
            self.network.load_state_dict(weights)
        else:  # of a version that kept them in the selector alone
            self._stored = self.best

    def write(self) -> None:
        """Write the selector, ``config.json`` and ``evaluation.csv``, after the checkpoint."""
        if self.network is not None and self.best is not self._stored:
            write_config(self.out, stored(self.config, self.banks, None))  # names no wrong score
            write_selector(self.out, self.network, self.sizes, self.kind)
            self._stored = self.best
        write_config(self.out, stored(self.config, self.banks, self.best))
        table = io.StringIO()
        writer = CsvWriter(table)
        writer.writerow(Evaluation._fields)
        writer.writerows(self.evaluations)
        write_whole(self.out / EVALUATIONS, table.getvalue().encode())


class Keeper(BaseCallback):
    """Evaluates, keeps the best selector, writes checkpoints, logs the terms of the reward.

    Args:
        out: the run folder.
        config: the training's configuration.
        banks: folders of the banks, for ``config.json``.
        held_out: the routes to evaluate on.
    """

    def __init__(
        self, out: Path, config: TrainingConfig, banks: Sequence[str | None], held_out: HeldOut
    ) -> None:
        super().__init__()
        self.out = out
        self.config = config
        self.held_out = held_out
        self.learner = learner(config.algorithm)
        self.records = Records(out, config, banks, self.learner.kind, self.learner.sizes(config))
        self._next = config.evaluate_every

    @property
    def network(self) -> nn.Module:
        """The network that is being trained."""
        return self.learner.network(self.model)

    def begin(self) -> None:
        """Start the run folder: its records and a first checkpoint."""
        self.records.write()
        self.checkpoint()

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self._log(info for info in self.locals["infos"] if "episode" in info)
        return True

    def _log(self, ended: Any) -> None:
        """Record means per frame of the reward's terms, and the return, of ended episodes."""
        for info in ended:
            self.logger.record_mean("route/return", info["episode"]["r"])
            for name, value in info["reward_terms"].items():
                self.logger.record_mean(f"route/{name}", value)

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps >= self._next:
            self.evaluate()

    def finish(self) -> None:
        """Evaluate the last weights, if that was not done."""
        done = self.records.evaluations
        if not done or done[-1].timesteps < self.model.num_timesteps:
            self.evaluate()
            self.logger.dump(self.model.num_timesteps)

    def evaluate(self) -> None:
        """Evaluate, keep the selector if it is the best, write a checkpoint."""
        steps = self.model.num_timesteps
        result = self.held_out.evaluate(self.records.policy(self.network), steps)
        for name, value in result._asdict().items():
            self.logger.record(f"held_out/{name}", value)
        self.records.add(result, self.network)
        self._next = steps + self.config.evaluate_every
        self.checkpoint()
        self.records.write()

    def save(self) -> None:
        """Keep what there is: a checkpoint, and a selector where none was evaluated yet."""
        self.checkpoint()
        self.records.write()
        if not self.records.evaluations:
            write_selector(self.out, self.network, self.records.sizes, self.records.kind)

    def checkpoint(self) -> None:
        """Write everything that resuming needs, as one file."""
        model = self.model
        tensors, metadata = self.records.checkpoint()
        tensors |= {f"policy.{k}": v for k, v in model.policy.state_dict().items()}
        optimiser = model.policy.optimizer.state_dict()["state"]
        for index, values in optimiser.items():
            tensors |= {f"optimiser.{index}.{k}": torch.as_tensor(v) for k, v in values.items()}
        tensors["random.torch"] = torch.get_rng_state()
        metadata |= {
            "timesteps": str(model.num_timesteps),
            "updates": str(model._n_updates),
            "numpy": json.dumps(_numpy_state()),
        }
        write_tensors(self.out / CHECKPOINT, tensors, metadata)

    def restore(self) -> None:
        """Take the model back to the last checkpoint; its routes begin anew.

        Raises:
            FileNotFoundError: if there is no checkpoint.
            ValueError: if it is damaged or another training's.
        """
        path = self.out / CHECKPOINT
        tensors, metadata = read_tensors(path)
        policy = part(tensors, "policy.")
        check_layers(path, policy, self.model.policy.state_dict())
        try:
            self.records.restore(path, tensors, metadata)
            self._restore(path, policy, tensors, metadata)
        except (LookupError, TypeError, ValueError, RuntimeError, ArithmeticError) as error:
            raise ValueError(f"{path} holds no whole checkpoint ({error}); train again") from error

    def _restore(
        self, path: Path, policy: Tensors, tensors: Tensors, metadata: dict[str, str]
    ) -> None:
        model = self.model
        model.policy.load_state_dict(policy)
        self._restore_optimiser(part(tensors, "optimiser."))
        model.num_timesteps = int(metadata["timesteps"])
        model._n_updates = int(metadata["updates"])
        self._next = model.num_timesteps + self.config.evaluate_every
        assert model.env is not None
        # Other routes than those already driven, but the same after every resume from here.
        model.env.seed(self.config.seed + model.num_timesteps)
        torch.set_rng_state(tensors["random.torch"])
        name, keys, *rest = read_list(path, metadata, "numpy")
        np.random.set_state((name, np.array(keys, np.uint32), *rest))

    def _restore_optimiser(self, tensors: Tensors) -> None:
        optimiser = self.model.policy.optimizer
        parameters = optimiser.param_groups[0]["params"]
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, tensor in tensors.items():
            index, _, key = name.partition(".")
            if tensor.ndim and tensor.shape != parameters[int(index)].shape:
                raise ValueError(f"shape {tuple(tensor.shape)} of the optimiser's {name!r}")
            state.setdefault(int(index), {})[key] = tensor
        optimiser.load_state_dict({**optimiser.state_dict(), "state": state})


def _numpy_state() -> list[Any]:
    name, keys, *rest = np.random.get_state(legacy=True)
    return [name, np.asarray(keys).tolist(), *rest]
