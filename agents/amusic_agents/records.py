"""What a training leaves in its run folder: evaluations, the best selector, checkpoints."""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any

from torch import nn

from amusic_agents.config import TrainingConfig
from amusic_agents.evaluation import Evaluation, HeldOut
from amusic_agents.network import NetworkSelector
from amusic_agents.run_folder import (
    BEST,
    CHECKPOINT,
    EVALUATIONS,
    SELECTOR,
    Tensors,
    check_layers,
    part,
    read_list,
    read_tensors,
    stored,
    write_config,
    write_selector,
    write_table,
    write_tensors,
)
from amusic_agents.selector import load_selector
from amusic_gym.utils.checks import number, whole


class Records:
    """A run folder's configuration, evaluations, best selector and checkpoint.

    The checkpoint holds the evaluations and the best selector too, and is written first: when a
    training that was killed between two files is resumed, all of them are again of one moment.
    ``evaluated`` is called with every evaluation once it is kept, those before a resume first.
    """

    def __init__(
        self,
        out: Path,
        config: TrainingConfig,
        banks: Sequence[str | None],
        kind: type[NetworkSelector],
        evaluated: Callable[[Evaluation], object] | None = None,
    ) -> None:
        self.out = out
        self.config = config
        self.banks = banks
        self.kind = kind
        self.held_out = HeldOut(config.held_out, config.statistic, config.acting_weights)
        self.evaluations: list[Evaluation] = []
        self.network: nn.Module | None = None  # the best
        self._stored: Evaluation | None = None  # of the selector on disk
        self._evaluated = evaluated or (lambda evaluation: None)
        self._told = 0  # evaluations

    @property
    def best(self) -> Evaluation | None:
        """The first of the highest score."""
        return max(self.evaluations, key=lambda result: result.score, default=None)

    def policy(self, network: nn.Module) -> NetworkSelector:
        """The policy around a network, limited to the λ that it acts at."""
        policy = self.kind(network, self.config.statistic, self.config.environment())
        policy.compute_weights = self.config.acting_weights
        return policy

    def evaluate(self, network: nn.Module, timesteps: int) -> Evaluation:
        """Evaluate a network on the held-out routes, and keep a copy of it if it is the best."""
        result = self.held_out.evaluate(self.policy(network), timesteps)
        if self.best is None or result.score > self.best.score:
            self.network = deepcopy(network)
        self.evaluations.append(result)
        return result

    def save(self, tensors: Tensors, metadata: dict[str, str]) -> None:
        """Write a checkpoint of these and of what is kept here, and the other files after it."""
        weights = {} if self.network is None else self.network.state_dict()
        best = {f"{BEST}{name}": tensor for name, tensor in weights.items()}
        metadata = {"evaluations": json.dumps(self.evaluations), **metadata}
        write_tensors(self.out / CHECKPOINT, {**best, **tensors}, metadata)
        self.write()

    def write(self) -> None:
        """Write the selector, ``config.json`` and ``evaluation.csv``."""
        if self.network is not None and self.best is not self._stored:
            write_config(self.out, stored(self.config, self.banks, None))  # names no wrong score
            self.write_selector(self.network)
            self._stored = self.best
        write_config(self.out, stored(self.config, self.banks, self.best))
        write_table(self.out / EVALUATIONS, Evaluation._fields, self.evaluations)
        for evaluation in self.evaluations[self._told :]:
            self._told += 1
            self._evaluated(evaluation)

    def write_selector(self, network: Any) -> None:
        """Store a network as the run's selector."""
        write_selector(self.out, network, network.sizes, self.kind.kind)

    @contextmanager
    def restoring(self, network: nn.Module) -> Iterator[tuple[Tensors, dict[str, str]]]:
        """The tensors and metadata of the checkpoint, after what is kept here was taken from it.

        ``network`` is of the kind that is trained; it stays as it is.

        Raises:
            FileNotFoundError: if there is no checkpoint.
            ValueError: if it, or the selector, is damaged; also for what the block finds wrong.
        """
        path = self.out / CHECKPOINT
        tensors, metadata = read_tensors(path)
        try:
            if (self.out / SELECTOR).exists():
                load_selector(self.out)
            rows = [Evaluation(*row) for row in read_list(path, metadata, "evaluations")]
            for row in rows:
                whole("timesteps", row.timesteps, 0)
                for name, value in row._asdict().items():
                    number(name, value, "a number")
            if weights := part(tensors, BEST):
                best = deepcopy(network)
                check_layers(path, weights, best.state_dict())
                best.load_state_dict(weights)
                self.network = best
            self.evaluations = rows
            yield tensors, metadata
        except (LookupError, TypeError, ValueError, RuntimeError, ArithmeticError) as error:
            raise ValueError(f"{path} holds no whole checkpoint ({error}); train again") from error
