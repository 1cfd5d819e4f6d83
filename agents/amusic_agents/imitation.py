"""Learning to select from a teacher (DAgger): the student drives, the teacher says what to do.

Ross, Gordon and Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", AISTATS 2011. Here a route is driven by one of the two from its beginning to its
end, because SIC profits from techniques that run many frames in a row.
"""

import json
from typing import NamedTuple

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits
from tqdm import tqdm

from amusic_agents.config import TrainingConfig
from amusic_agents.learning import fit, make_env
from amusic_agents.network import SelectorNetwork, presence
from amusic_agents.records import Records
from amusic_agents.run_folder import CHECKPOINT, check_layers, part, read_list, write_table
from amusic_agents.selector import TrainedSelector
from amusic_gym.envs.observation import observation_size
from amusic_gym.envs.sources import RouteSource
from amusic_gym.policies.protocol import Correction, Needs, Selector

TABLE = "imitation.csv"


class Round(NamedTuple):
    """How a round went."""

    teacher_share: float  # expected share of the routes that the teacher drove
    # share of the bits on which the student, before it learned from the round, would have done what
    # the teacher said
    agreement: float
    loss: float  # mean cross entropy per bit in the last pass


class ImitationLearner:
    """The rounds of an imitation.

    Raises:
        ValueError: if there is no teacher, or it needs another environment.
    """

    kind = TrainedSelector

    def __init__(
        self,
        config: TrainingConfig,
        source: RouteSource,
        records: Records,
        teacher: Selector | None = None,
    ) -> None:
        self.config = config
        self.settings = config.imitation
        self.records = records
        self.teacher = _checked(teacher, config)
        self.env = make_env(config, source)
        torch.manual_seed(config.seed)
        self.network = SelectorNetwork(config.network)
        self.student = records.policy(self.network)
        self.rounds: list[Round] = []
        self.steps = -(-self.settings.frames // config.n_envs)  # of every route in a round
        self.frames = self.steps * config.n_envs  # of a round
        total, slots = self.settings.rounds * self.frames, self.env.task.slots
        self.observations = torch.empty(total, observation_size(slots))  # what was seen
        self.labels = torch.empty(total, slots, dtype=torch.bool)  # and what the teacher said

    def run(self, progress: bool) -> None:
        """Drive, learn, evaluate and save, round by round."""
        self._write_table()
        with tqdm(
            total=len(self.labels),
            initial=len(self.rounds) * self.frames,
            desc="imitation",
            unit=" frames",
            disable=not progress,
        ) as bar:
            while len(self.rounds) < self.settings.rounds:
                self._round(bar)

    def _round(self, bar: tqdm) -> None:
        number = len(self.rounds)
        rng = np.random.default_rng([self.config.seed, number])
        share, end = self.settings.teacher_share**number, (number + 1) * self.frames
        agreed = self._drive(rng, share, slice(end - self.frames, end), bar)

        def loss_of(batch: torch.Tensor) -> torch.Tensor:
            return cross_entropy(self.network, self.observations[batch], self.labels[batch])

        batches = -(-end // self.settings.batch_size)
        loss = fit(self.network, loss_of, end, batches, self.settings, rng)
        result = self.records.evaluate(self.network, end)
        self.rounds.append(Round(share, agreed, loss))
        self._save()
        bar.set_postfix(agreement=f"{agreed:.3f}", score=f"{result.score:.3f}")

    def _drive(self, rng: np.random.Generator, share: float, rows: slice, bar: tqdm) -> float:
        """Let the teacher label a drive on all routes; share of the student's bits that agree."""
        routes, agreed = self.config.n_envs, []
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
            agreed.append((own == labels[step])[info["present"]])
            actions = np.where(taught[:, None], labels[step], own)
            observation, _, terminated, truncated, info = self.env.step(actions)
            begun = terminated | truncated
            bar.update(routes)
        return float(np.concatenate(agreed).mean())

    def _save(self) -> None:
        tensors = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        if len(self.rounds) < self.settings.rounds:  # else nothing is learned from it any more
            seen = len(self.rounds) * self.frames
            tensors["seen.observations"] = self.observations[:seen]
            tensors["seen.labels"] = self.labels[:seen]
        self.records.save(tensors, {"rounds": json.dumps(self.rounds)})
        self._write_table()

    def _write_table(self) -> None:
        rows = [(number, *values) for number, values in enumerate(self.rounds)]
        write_table(self.records.out / TABLE, ("round", *Round._fields), rows)

    def restore(self) -> None:
        """Go back to the end of the last whole round; a damaged checkpoint is refused."""
        with self.records.restoring(self.network) as (tensors, metadata):
            path = self.records.out / CHECKPOINT
            rounds = [Round(*row) for row in read_list(path, metadata, "rounds")]
            weights = part(tensors, "network.")
            check_layers(path, weights, self.network.state_dict())
            if len(rounds) < self.settings.rounds:
                seen = len(rounds) * self.frames
                own = {"observations": self.observations[:seen], "labels": self.labels[:seen]}
                check_layers(path, part(tensors, "seen."), own)
                for name, tensor in own.items():
                    tensor.copy_(tensors[f"seen.{name}"])
            self.network.load_state_dict(weights)
            self.rounds = rounds


def cross_entropy(
    network: SelectorNetwork, observations: torch.Tensor, labels: torch.Tensor
) -> torch.Tensor:
    """Mean cross entropy of the bits of the techniques that are there."""
    logits, present = network.logits(observations), presence(observations).float()
    sums = binary_cross_entropy_with_logits(logits, labels.float(), present, reduction="sum")
    return sums / present.sum()


def _checked(teacher: Selector | None, config: TrainingConfig) -> Selector:
    """The teacher, unless it needs another environment than the training's."""
    if teacher is None:
        raise ValueError("an imitation learns from a teacher; give one")
    needs = teacher.needs
    if needs != Needs(statistic=needs.statistic, carry=needs.carry, discount=needs.discount):
        raise ValueError(
            "the teacher needs more of the environment than a statistic (the re-select bit, idling"
            " or other arguments), which the network cannot learn; give one that does not"
        )
    if needs.statistic not in (None, config.statistic):
        raise ValueError(
            f"the teacher needs the statistic {needs.statistic!r}, the training uses"
            f" {config.statistic!r}; give the same"
        )
    own = Correction.under(teacher, config.statistic, config.carry, config.discount)._asdict()
    for name, value in config.environment().items():
        if own[name] != value:
            raise ValueError(
                f"the teacher needs {name} {own[name]}, the training uses {value}; give the same"
            )
    return teacher
