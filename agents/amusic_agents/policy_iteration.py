"""Policy iteration by rollouts: what does it lead to, to run this subset of techniques now?

On frames of simulated drives the routes are copied. Each copy runs another subset of techniques for
some frames, and goes on as the policy so far would. What comes of it, in correctness and in
compute, is what a network learns to predict from the observation; the next policy runs the subset
of which it expects most. Lagoudakis and Parr, "Reinforcement learning as classification: leveraging
modern classifiers", ICML 2003; here the values are fitted, not classes, because no drive tells
beforehand which technique will be right.

A policy gradient does not find this by itself: a good technique that runs alone pays, one that runs
beside those that mislead does not, so that every small step towards it costs more than it gives.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from amusic_agents.config import RolloutConfig, TrainingConfig
from amusic_agents.evaluation import HeldOut
from amusic_agents.keeper import Records
from amusic_agents.learners.common import make_env
from amusic_agents.run_folder import CHECKPOINT, check_layers, part, read_tensors, write_tensors
from amusic_agents.selector import load_selector
from amusic_agents.subsets import MOST_SLOTS, SubsetNetwork, SubsetSelector, SubsetSizes
from amusic_agents.training import bank_folders, begun, training_source
from amusic_gym.envs.observation import observation_size
from amusic_gym.envs.sources import BankLike, RouteSource
from amusic_gym.envs.task import Task
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.policies.protocol import Selector

SPELL = (3, 50)
"""Frames for which a route of a collection is driven in one way: by the policy, or by a subset."""

PART = 1000
"""States that are collected in one go, from the beginning of every route on."""

PACE = 2
"""Frames between two decisions of the policy in a rollout; half of the time goes into them."""


class Samples(NamedTuple):
    """What rollouts from n states by B subsets each came to.

    Attributes:
        observations: (n, D) float32.
        subsets: (n, B) number of each subset: bit t for slot t.
        correctness: (n, B) float32, discounted mean of the reward without compute.
        compute: (n, B) float32, discounted mean of the compute.
    """

    observations: NDArray[np.float32]
    subsets: NDArray[np.int64]
    correctness: NDArray[np.float32]
    compute: NDArray[np.float32]


def iterate_policy(
    out: str | Path,
    config: TrainingConfig,
    *,
    banks: Sequence[BankLike] = (),
    source: RouteSource | None = None,
    resume: bool = False,
    progress: bool = True,
) -> Selector:
    """Train a selector by policy iteration and keep the best in a run folder.

    Args:
        out: the run folder.
        config: how; ``config.rollouts`` above all.
        banks: banks to drive on; none: simulated routes.
        source: routes to drive on, instead of banks or the default simulation.
        resume: go on after the folder's last whole iteration, with its configuration and banks, and
            with the same result as without a stop. A finished one is returned as it is.
        progress: whether to show a progress bar.

    Returns:
        The best selector by evaluation on held-out simulated routes.

    Raises:
        FileNotFoundError: if there is nothing to resume, or a bank is missing.
        ValueError: if the folder holds another training or is damaged, or a route is live.
    """
    out = Path(out)
    with begun(out, config, banks, source, resume) as (config, banks):
        iteration = PolicyIteration(out, config, source or training_source(config, banks))
        iteration.records.banks = bank_folders(source, banks)
        if resume:
            iteration.restore()
        iteration.records.write()
        iteration.run(progress)
        return load_selector(out)


class PolicyIteration:
    """The iterations, and what they leave on disk.

    Args:
        out: the run folder.
        config: how; ``config.rollouts`` above all.
        source: routes to drive on.
    """

    def __init__(self, out: Path, config: TrainingConfig, source: RouteSource) -> None:
        self.out = out
        self.config = config
        if source.slots > MOST_SLOTS:
            raise ValueError(
                f"routes of {source.slots} techniques have too many subsets to try; give routes of"
                f" at most {MOST_SLOTS}, or take --algorithm ppo"
            )
        self.settings: RolloutConfig = config.rollouts
        self.source = source
        self.records = Records(out, config, [], "subsets", SubsetSizes())
        self.held_out = HeldOut(config.held_out, config.statistic)
        self.policy: SubsetSelector | None = None
        self.seen: list[Samples] = []  # of the last iterations
        self.done = 0  # iterations

    def run(self, progress: bool) -> None:
        """Collect, learn, evaluate and keep, iteration by iteration."""
        total = self.settings.iterations * self.settings.states
        begun = self.done * self.settings.states
        with (
            tqdm(total=total, initial=begun, desc="rollouts", disable=not progress) as bar,
            Collectors(self.config, self.source) as collectors,
        ):
            while self.done < self.settings.iterations:
                self._iterate(collectors, bar)

    def _iterate(self, collectors: Collectors, bar: tqdm) -> None:
        rng = np.random.default_rng([self.config.seed, self.done])
        if self.done == 1:  # without a policy a subset runs to the end, which is another value
            self.seen.clear()
        self.seen = [*self.seen, collectors.collect(self.policy, rng, bar)]
        self.seen = self.seen[-self.settings.kept :]
        torch.manual_seed(int(rng.integers(2**31)))
        network = SubsetNetwork(SubsetSizes())
        loss = learn(network, self.seen, self.settings, rng)
        self.policy = SubsetSelector(network, self.config.statistic, self.config.environment())
        self.done += 1
        result = self.held_out.evaluate(self.policy, self.done * self.settings.states)
        self.records.add(result, network)
        self._save(network)
        bar.set_postfix(loss=f"{loss:.3f}", score=f"{result.score:.3f}")

    # ---- on disk ---------------------------------------------------------------------------

    def _save(self, network: SubsetNetwork) -> None:
        tensors, metadata = self.records.checkpoint()
        tensors |= {f"network.{name}": value for name, value in network.state_dict().items()}
        for i, samples in enumerate(self.seen):
            for name, array in samples._asdict().items():
                tensors[f"seen.{i}.{name}"] = torch.from_numpy(array)
        write_tensors(self.out / CHECKPOINT, tensors, {**metadata, "done": str(self.done)})
        self.records.write()

    def _check(self, samples: Samples) -> None:
        """Refuse what no collection gave, or one on routes of another number of slots."""
        observations, subsets, *values = samples
        states = len(subsets), observation_size(self.source.slots)
        good = observations.shape == states and {a.shape for a in values} == {subsets.shape}
        kinds = [array.dtype for array in samples] == [np.float32, np.int64, np.float32, np.float32]
        if not (good and kinds and ((subsets >= 0) & (subsets < 1 << self.source.slots)).all()):
            raise ValueError("states of another size or kind")

    def restore(self) -> None:
        """Go back to the end of the last whole iteration; before the first, to the beginning.

        Raises:
            ValueError: if the checkpoint is damaged.
        """
        path = self.out / CHECKPOINT
        if not path.exists():  # stopped within the first iteration
            return
        tensors, metadata = read_tensors(path)
        network = SubsetNetwork(SubsetSizes())
        weights = part(tensors, "network.")
        check_layers(path, weights, network.state_dict())
        network.load_state_dict(weights)
        self.policy = SubsetSelector(network, self.config.statistic, self.config.environment())
        try:
            self.done = int(metadata["done"])
            kept = min(max(1, self.done - 1), self.settings.kept)
            self.seen = [
                Samples(*(tensors[f"seen.{i}.{name}"].numpy() for name in Samples._fields))
                for i in range(kept)
            ]
            for samples in self.seen:
                self._check(samples)
            self.records.restore(path, tensors, metadata)
        except (LookupError, TypeError, ValueError, ArithmeticError) as error:
            raise ValueError(f"{path} holds no whole checkpoint ({error}); train again") from error


# ---- collecting ----------------------------------------------------------------------------


class Behaviour:
    """How the drives of a collection go: each spell by the policy, or by one subset.

    Spells of a subset bring a drive where the policy would not, and where it must find back from.

    Args:
        routes: N.
        slots: S.
        policy: the policy so far; None: subsets only.
        share: of the spells that the policy drives.
        rng: of all that is drawn.
        idle: whether a subset may be empty.
    """

    def __init__(
        self,
        routes: int,
        slots: int,
        policy: SubsetSelector | None,
        share: float,
        rng: np.random.Generator,
        idle: bool = False,
    ) -> None:
        self.sizes = (1, 1, 1, 2, 2, 3, MOST_SLOTS, *([0] if idle else []))
        self.policy = policy
        self.share = share if policy is not None else 0.0
        self.rng = rng
        self.left = np.zeros(routes, np.int64)  # frames of the spell
        self.own = np.zeros(routes, np.bool_)  # driven by the policy
        self.subset = np.zeros((routes, slots), np.bool_)

    def act(
        self, observation: NDArray[np.float32], present: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Actions (N, S) from observations (N, D) and which slots hold a technique (N, S)."""
        for i in np.flatnonzero(self.left <= 0):
            self.left[i] = self.rng.integers(*SPELL)
            self.own[i] = self.rng.random() < self.share
            self.subset[i] = draw_subset(present[i], self.sizes, self.rng)
        self.left -= 1
        if self.policy is None:
            return self.subset.copy()
        return np.where(self.own[:, None], self.policy.act(observation, {}), self.subset)


def draw_subset(
    present: NDArray[np.bool_], sizes: Sequence[int], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """A subset (S,) of the techniques that are there, of a size drawn from ``sizes``."""
    there = np.flatnonzero(present)
    size = min(int(rng.choice(sizes)), there.size)
    subset = np.zeros(present.size, np.bool_)
    subset[rng.choice(there, size, replace=False)] = True
    return subset


def draw_subsets(
    action: NDArray[np.bool_],
    present: NDArray[np.bool_],
    count: int,
    rng: np.random.Generator,
    idle: bool = False,
) -> NDArray[np.bool_]:
    """(B, S) subsets to try in a state: the policy's, single techniques, all, and others.

    The last one is empty if ``idle``.
    """
    singles = rng.permutation(np.flatnonzero(present))[: count - 3]
    rest = count - 2 - singles.size
    others = [draw_subset(present, (2, 2, 2, 3, MOST_SLOTS), rng) for _ in range(rest)]
    if idle:
        others[-1] = np.zeros(present.size, np.bool_)
    return np.array([action, *np.eye(present.size, dtype=np.bool_)[singles], present, *others])


class Collectors:
    """Collects in parts, in this process or, with ``config.threads``, in several others.

    What is collected does not depend on how many there are.

    Args:
        config: of the training.
        source: routes to drive on.
    """

    def __init__(self, config: TrainingConfig, source: RouteSource) -> None:
        self.settings = config.rollouts
        self._pool: ProcessPoolExecutor | None = None
        one = replace(config, threads=1)  # of the statistic belief
        if config.threads == 1:
            _begin(one, source)
        else:
            self._others = set(multiprocessing.active_children())
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(config.threads, context, _begin, (one, source))

    def __enter__(self) -> Collectors:
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        if self._pool is None:
            return
        if error is not None:  # what the others are at is of no use any more
            for process in set(multiprocessing.active_children()) - self._others:
                process.terminate()
        self._pool.shutdown(cancel_futures=True)

    def collect(
        self, policy: SubsetSelector | None, rng: np.random.Generator, bar: tqdm
    ) -> Samples:
        """What rollouts from an iteration's states come to.

        Args:
            policy: the policy so far; None at first.
            rng: of the seeds of the parts.
            bar: moves on by the states.
        """
        seeds = rng.integers(2**63, size=-(-self.settings.states // PART)).tolist()
        weights = None
        if policy is not None:
            weights = {name: w.numpy() for name, w in policy.network.state_dict().items()}
        parts: list[Samples] = []
        run: Any = map if self._pool is None else self._pool.map
        for samples in run(_collect_part, seeds, repeat(weights)):
            parts.append(samples)
            bar.update(min(PART, self.settings.states))
        return Samples(*(np.concatenate(column) for column in zip(*parts, strict=True)))


_worker: dict[str, Any] = {}
"""What a collecting process keeps: the configuration and the environment."""


def _begin(config: TrainingConfig, source: RouteSource) -> None:
    """Make a process ready to collect."""
    if multiprocessing.parent_process() is not None:
        for number in (signal.SIGINT, signal.SIGHUP):  # the main process ends the others
            signal.signal(number, signal.SIG_IGN)
    _worker.update(config=config, env=make_env(config, source))


def _collect_part(seed: int, weights: dict[str, NDArray[np.float32]] | None) -> Samples:
    """Collect ``PART`` states, or all where there are fewer, in any process that is ready."""
    config: TrainingConfig = _worker["config"]
    policy = None
    if weights is not None:
        network = SubsetNetwork(SubsetSizes())
        network.load_state_dict({name: torch.from_numpy(w) for name, w in weights.items()})
        policy = SubsetSelector(network, config.statistic, config.environment())
    return collect(_worker["env"], policy, config.rollouts, np.random.default_rng(seed))


def collect(
    env: TechniqueSelectionVectorEnv,
    policy: SubsetSelector | None,
    settings: RolloutConfig,
    rng: np.random.Generator,
) -> Samples:
    """Drive, and try subsets by rollouts on every so many frames.

    Args:
        env: the routes; with SAME_STEP autoreset.
        policy: the policy so far; None at first: then a subset runs to the end of its rollout.
        settings: how many subsets and frames.
        rng: of all that is drawn.
    """
    slots = env.task.slots
    observation, info = env.reset(seed=int(rng.integers(2**31)))
    idle = env.task.episodes.allow_idle
    drives = Behaviour(env.num_envs, slots, policy, settings.share, rng, idle)
    parts: list[Samples] = []
    steps = -(-min(PART, settings.states) // env.num_envs) * settings.every
    for step in range(steps):
        actions = drives.act(observation, info["present"])
        observation, _, terminated, truncated, info = env.step(actions)
        drives.left[terminated | truncated] = 0
        if (step + 1) % settings.every:
            continue
        own = drives.subset if policy is None else policy.act(observation, {})
        subsets = np.stack(
            [
                draw_subsets(action, present, settings.subsets, rng, idle)
                for action, present in zip(own, info["present"], strict=True)
            ]
        )  # (N, B, S)
        correctness, compute = roll_out(env.task, subsets, policy, settings)
        numbers = (subsets * (1 << np.arange(slots))).sum(2)
        parts.append(Samples(observation.copy(), numbers, correctness, compute))
    return Samples(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def roll_out(
    task: Task,
    subsets: NDArray[np.bool_],
    policy: SubsetSelector | None,
    settings: RolloutConfig,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What each subset leads to, from where the routes are.

    Args:
        task: N routes; they stay as they are.
        subsets: (N, B, S) to run at first.
        policy: goes on after ``settings.hold`` frames; None: the subset does.
        settings: frames and discount.

    Returns:
        (N, B) discounted means per frame of the horizon of the reward without compute, and of the
        compute; both are 0 after a route's end.
    """
    routes, count, slots = subsets.shape
    copies = task.repeated(count)
    first = subsets.reshape(-1, slots)
    active = np.ones(len(first), np.bool_)
    sums = np.zeros((2, len(first)))
    actions = first
    weights = np.cumprod([1.0, *[settings.discount] * (settings.horizon - 1)])
    observation: NDArray[np.float32] | None = None
    for frame, weight in enumerate(weights):
        since = frame - settings.hold
        if policy is not None and observation is not None and since >= 0 and since % PACE == 0:
            actions = policy.act(observation, {})
        out, _, terms = copies.step(actions, active)
        rewards = sum((v for k, v in terms.items() if k != "compute"), np.zeros(len(first)))
        sums += weight * np.where(active, [rewards, out.routes["compute"]], 0.0)
        active &= ~copies.ends(out)[0]
        observation = out.observation
        if not active.any():
            break
    means = (sums / weights.cumsum()[-1]).astype(np.float32)
    correctness, compute = means.reshape(2, routes, count)
    return correctness, compute


# ---- learning ------------------------------------------------------------------------------


def learn(
    network: SubsetNetwork,
    seen: Sequence[Samples],
    settings: RolloutConfig,
    rng: np.random.Generator,
) -> float:
    """Fit a network to what rollouts came to; mean loss of the last pass.

    Only differences between the subsets of a state count: from there on the drives are the same.
    """
    columns = [np.concatenate(column) for column in zip(*seen, strict=True)]
    observations, subsets, *values = (torch.from_numpy(column) for column in columns)
    target = centred(torch.stack(values, dim=2))  # (n, B, 2)
    batches = len(subsets) // settings.batch_size
    steps = settings.epochs * batches
    optimiser = torch.optim.Adam(network.parameters(), weight_decay=1e-5)
    losses = np.zeros(steps)
    for step in range(steps):
        if step % batches == 0:
            order = torch.from_numpy(rng.permutation(len(subsets)))
        batch = order[step % batches :: batches]
        optimiser.param_groups[0]["lr"] = settings.learning_rate * (1.0 - step / steps)
        values_of = network.values(observations[batch])  # (E, b, 2^S, 2)
        index = subsets[batch].unsqueeze(2).expand(len(values_of), -1, -1, 2)
        error = centred(values_of.gather(2, index)) - target[batch]
        loss = 100.0 * (error**2).mean((1, 2, 3)).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses[step] = loss.detach()
    return float(losses[-batches:].mean()) / len(network.ensemble)


def centred(values: torch.Tensor) -> torch.Tensor:
    """Values (..., B, 2) less their mean over the subsets."""
    return values - values.mean(-2, keepdim=True)
