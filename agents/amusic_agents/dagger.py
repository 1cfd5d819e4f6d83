"""The rounds of an imitation, and what they leave on disk: see :mod:`amusic_agents.imitation`."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits
from tqdm import tqdm

from amusic_agents.config import TrainingConfig
from amusic_agents.evaluation import Evaluation, HeldOut
from amusic_agents.keeper import Records
from amusic_agents.learners.common import make_env
from amusic_agents.network import SelectorNetwork, presence
from amusic_agents.run_folder import (
    BEST,
    CHECKPOINT,
    check_layers,
    read_list,
    read_tensors,
    write_tensors,
)
from amusic_agents.selector import TrainedSelector
from amusic_gym.envs.observation import observation_size
from amusic_gym.envs.sources import RouteSource
from amusic_gym.policies.protocol import Selector
from amusic_gym.utils.escaping import CsvWriter
from amusic_gym.utils.storage import write_whole

SEEN = "seen"
"""Folder of what was seen in each round; it goes when the last one is done."""

TABLE = "imitation.csv"


class Round(NamedTuple):
    """How a round went.

    Attributes:
        teacher_share: expected share of the routes that the teacher drove.
        agreement: share of the bits on which the student, before it learned from the round, would
            have done what the teacher said.
        loss: mean cross entropy per bit in the last pass.
    """

    teacher_share: float
    agreement: float
    loss: float


class DAgger:
    """The rounds of an imitation.

    Args:
        out: the run folder.
        config: how.
        teacher: says what to do.
        source: routes to drive on.
    """

    def __init__(
        self, out: Path, config: TrainingConfig, teacher: Selector, source: RouteSource
    ) -> None:
        self.out = out
        self.config = config
        self.settings = config.imitation
        self.teacher = teacher
        self.env = make_env(config, source)
        torch.manual_seed(config.seed)
        self.network = SelectorNetwork(config.network)
        self.student = TrainedSelector(self.network, config.statistic, config.environment())
        self.records = Records(out, config, [], "selector", config.network)
        self.held_out = HeldOut(config.held_out, config.statistic)
        self.rounds: list[Round] = []
        self.steps = -(-self.settings.frames // config.n_envs)  # of every route in a round
        self.frames = self.steps * config.n_envs  # of a round
        total, slots = self.settings.rounds * self.frames, self.env.task.slots
        self.observations = torch.empty(total, observation_size(slots))  # what was seen
        self.labels = torch.empty(total, slots, dtype=torch.bool)  # and what the teacher said

    # ---- the rounds ------------------------------------------------------------------------

    def run(self, progress: bool) -> None:
        """Drive, learn, evaluate and keep, round by round."""
        bar = tqdm(
            total=len(self.labels),
            initial=len(self.rounds) * self.frames,
            desc="imitation",
            unit=" frames",
            disable=not progress,
        )
        with bar:
            while len(self.rounds) < self.settings.rounds:
                self._round(bar)
        shutil.rmtree(self.out / SEEN, ignore_errors=True)

    def _round(self, bar: tqdm) -> None:
        number = len(self.rounds)
        rng = np.random.default_rng([self.config.seed, number])
        share = self.settings.teacher_share**number
        self._drive(rng, share, bar)
        agreed = self._agreement(self._rows(number))
        loss = self._learn(rng, (number + 1) * self.frames)
        result = self.held_out.evaluate(self.student, (number + 1) * self.frames)
        self.rounds.append(Round(share, agreed, loss))
        self._keep(result)
        bar.set_postfix(agreement=f"{agreed:.3f}", score=f"{result.score:.3f}")

    def _rows(self, number: int) -> slice:
        """Where a round's frames are."""
        return slice(number * self.frames, (number + 1) * self.frames)

    def _drive(self, rng: np.random.Generator, share: float, bar: tqdm) -> None:
        """Drive on all routes, from their beginnings; the teacher labels every frame."""
        routes, rows = self.config.n_envs, self._rows(len(self.rounds))
        observations = self.observations[rows].numpy().reshape(self.steps, routes, -1)
        labels = self.labels[rows].numpy().reshape(self.steps, routes, -1)
        observation, info = self.env.reset(seed=int(rng.integers(2**31)))
        begun = np.ones(routes, np.bool_)
        taught = np.zeros(routes, np.bool_)  # driven by the teacher
        for step in range(self.steps):
            self.teacher.reset(begun)
            taught = np.where(begun, rng.random(routes) < share, taught)
            observations[step] = observation
            labels[step] = self.teacher.act(observation, info)
            own = self.student.act(observation, info)
            actions = np.where(taught[:, None], labels[step], own)
            observation, _, terminated, truncated, info = self.env.step(actions)
            begun = terminated | truncated
            bar.update(routes)

    @torch.no_grad()
    def _agreement(self, rows: slice) -> float:
        """Share of the bits that the student would have set as the teacher did."""
        same, bits = 0, 0
        size = self.settings.batch_size
        parts = self.observations[rows].split(size), self.labels[rows].split(size)
        for observations, labels in zip(*parts, strict=True):
            present = presence(observations)
            runs = self.network.logits(observations) > 0.0
            same += int(((runs == labels) & present).sum())
            bits += int(present.sum())
        return same / bits

    def _learn(self, rng: np.random.Generator, seen: int) -> float:
        """Fit the network to the first ``seen`` frames; mean loss of the last pass."""
        batches = -(-seen // self.settings.batch_size)
        steps = self.settings.epochs * batches
        optimiser = torch.optim.Adam(self.network.parameters())
        losses = np.zeros(steps)
        for step in range(steps):
            if step % batches == 0:
                order = torch.from_numpy(rng.permutation(seen))
            batch = order[step % batches :: batches]
            optimiser.param_groups[0]["lr"] = self.settings.learning_rate * (1.0 - step / steps)
            loss = cross_entropy(self.network, self.observations[batch], self.labels[batch])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses[step] = loss.detach()
        return float(losses[-batches:].mean())

    # ---- on disk ---------------------------------------------------------------------------

    def _keep(self, result: Evaluation) -> None:
        """Write all that the next round needs; what was seen first, and then the checkpoint."""
        number = len(self.rounds) - 1
        if len(self.rounds) < self.settings.rounds:
            rows = self._rows(number)
            seen = {"observations": self.observations[rows], "labels": self.labels[rows]}
            write_tensors(self._seen_file(number), seen, {})
        self.records.add(result, self.network)
        tensors, metadata = self.records.checkpoint()
        tensors |= self.network.state_dict()
        metadata |= {"rounds": json.dumps(self.rounds)}
        write_tensors(self.out / CHECKPOINT, tensors, metadata)
        self.write()

    def write(self) -> None:
        """Write the records, and the table of the rounds."""
        self.records.write()
        table = io.StringIO()
        writer = CsvWriter(table)
        writer.writerow(("round", *Round._fields))
        writer.writerows((i, *values) for i, values in enumerate(self.rounds))
        write_whole(self.out / TABLE, table.getvalue().encode())

    def _seen_file(self, number: int) -> Path:
        return self.out / SEEN / f"{number}.safetensors"

    def restore(self) -> None:
        """Go back to the end of the last whole round; before the first, to the beginning.

        Raises:
            FileNotFoundError: if what was seen in a round is missing.
            ValueError: if the checkpoint, or what was seen, is damaged.
        """
        path = self.out / CHECKPOINT
        if not path.exists():  # stopped within the first round
            return
        tensors, metadata = read_tensors(path)
        weights = {name: tensor for name, tensor in tensors.items() if not name.startswith(BEST)}
        check_layers(path, weights, self.network.state_dict())
        try:
            rounds = [Round(*row) for row in read_list(path, metadata, "rounds")]
            self.records.restore(path, tensors, metadata)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} holds no whole checkpoint ({error}); train again") from error
        if len(rounds) < self.settings.rounds:
            for number in range(len(rounds)):
                self._read_seen(number)
        self.network.load_state_dict(weights)
        self.rounds = rounds

    def _read_seen(self, number: int) -> None:
        path, rows = self._seen_file(number), self._rows(number)
        tensors, _ = read_tensors(path)
        own = {"observations": self.observations[rows], "labels": self.labels[rows]}
        check_layers(path, tensors, own)
        for name, tensor in own.items():
            tensor.copy_(tensors[name])


def cross_entropy(
    network: SelectorNetwork, observations: torch.Tensor, labels: torch.Tensor
) -> torch.Tensor:
    """Mean cross entropy of the bits of the techniques that are there."""
    logits, present = network.logits(observations), presence(observations).float()
    sums = binary_cross_entropy_with_logits(logits, labels.float(), present, reduction="sum")
    return sums / present.sum()
