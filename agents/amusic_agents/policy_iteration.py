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

import multiprocessing
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from amusic_agents.config import RolloutConfig, TrainingConfig
from amusic_agents.learning import fit, make_env
from amusic_agents.records import Records
from amusic_agents.run_folder import CHECKPOINT, check_layers, part
from amusic_agents.subsets import MOST_SLOTS, SubsetNetwork, SubsetSelector, SubsetSizes
from amusic_gym.envs.observation import observation_size
from amusic_gym.envs.sources import RouteSource
from amusic_gym.envs.task import Task
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

SPELL = (3, 50)  # frames of a collection driven in one way: by the policy, or by a subset
PART = 1000  # states that are collected in one go, from the beginning of every route on
ACTION_REPEAT = 2  # frames between two decisions in a rollout; half of the time goes into them


class Samples(NamedTuple):
    """What rollouts from n states by B subsets each came to."""

    observations: NDArray[np.float32]  # (n, D) float32
    subsets: NDArray[np.int64]  # (n, B) number of each subset: bit t for slot t
    # (n, B) float32, discounted mean of the reward without compute
    correctness: NDArray[np.float32]
    compute: NDArray[np.float32]  # (n, B) float32, discounted mean of the compute


def joined(parts: Sequence[Samples]) -> Samples:
    """All states of the parts, one after the other."""
    return Samples(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class RolloutLearner:
    """The iterations of collecting and learning."""

    kind = SubsetSelector

    def __init__(self, config: TrainingConfig, source: RouteSource, records: Records) -> None:
        if source.slots > MOST_SLOTS:
            raise ValueError(
                f"routes of {source.slots} techniques have too many subsets to try; give routes of"
                f" at most {MOST_SLOTS}, or take --algorithm ppo"
            )
        self.config = config
        self.settings = config.rollouts
        self.source = source
        self.records = records
        self.network: SubsetNetwork | None = None
        self.seen: list[Samples] = []  # of the last iterations
        self.done = 0  # iterations

    def run(self, progress: bool) -> None:
        """Collect, learn, evaluate and save, iteration by iteration."""
        total = self.settings.iterations * self.settings.states
        begun = self.done * self.settings.states
        with (
            tqdm(total=total, initial=begun, desc="rollouts", disable=not progress) as bar,
            collecting(self.config, self.source) as run,
        ):
            while self.done < self.settings.iterations:
                self._iterate(run, bar)

    def _iterate(self, run: Any, bar: tqdm) -> None:
        rng = np.random.default_rng([self.config.seed, self.done])
        if self.done == 1:  # without a policy a subset runs to the end, which is another value
            self.seen.clear()
        seeds = rng.integers(2**63, size=-(-self.settings.states // PART)).tolist()
        weights = None  # as arrays: tensors would take shared memory on their way
        if self.network is not None:
            weights = {name: tensor.numpy() for name, tensor in self.network.state_dict().items()}
        parts: list[Samples] = []
        for samples in run(_collect_part, seeds, repeat(weights)):
            parts.append(samples)
            bar.update(min(PART, self.settings.states))
        self.seen = [*self.seen, joined(parts)][-self.settings.kept :]
        torch.manual_seed(int(rng.integers(2**31)))
        self.network = SubsetNetwork(SubsetSizes())
        loss = learn(self.network, self.seen, self.settings, rng)
        self.done += 1
        result = self.records.evaluate(self.network, self.done * self.settings.states)
        self._save(self.network)
        bar.set_postfix(loss=f"{loss:.3f}", score=f"{result.score:.3f}")

    def _save(self, network: SubsetNetwork) -> None:
        tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
        for i, samples in enumerate(self.seen):
            for name, array in samples._asdict().items():
                tensors[f"seen.{i}.{name}"] = torch.from_numpy(array)
        self.records.save(tensors, {"done": str(self.done)})

    def restore(self) -> None:
        """Go back to the end of the last whole iteration; a damaged checkpoint is refused."""
        network = SubsetNetwork(SubsetSizes())
        with self.records.restoring(network) as (tensors, metadata):
            weights = part(tensors, "network.")
            check_layers(self.records.out / CHECKPOINT, weights, network.state_dict())
            network.load_state_dict(weights)
            self.network = network
            self.done = int(metadata["done"])
            kept = min(max(1, self.done - 1), self.settings.kept)
            self.seen = [
                Samples(*(tensors[f"seen.{i}.{name}"].numpy() for name in Samples._fields))
                for i in range(kept)
            ]
            for samples in self.seen:
                self._check(samples)

    def _check(self, samples: Samples) -> None:
        """Refuse what no collection gave, or one on routes of another number of slots."""
        observations, subsets, *values = samples
        states = len(subsets), observation_size(self.source.slots)
        good = observations.shape == states and {a.shape for a in values} == {subsets.shape}
        kinds = [array.dtype for array in samples] == [np.float32, np.int64, np.float32, np.float32]
        if not (good and kinds and ((subsets >= 0) & (subsets < 1 << self.source.slots)).all()):
            raise ValueError("states of another size or kind")


class BehaviourPolicy:
    """Drives the routes of a collection: each spell by the policy so far, or by one subset.

    Subsets lead to states that the policy would not come to, and must recover from. ``share`` of
    the spells are the policy's, where there is one; a subset may be empty if ``idle``.
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


@contextmanager
def collecting(config: TrainingConfig, source: RouteSource) -> Iterator[Any]:
    """A ``map`` for `_collect_part`: in this process or, with ``config.threads``, in several.

    What is collected does not depend on how many there are.
    """
    one = replace(config, threads=1)  # of the statistic belief
    if config.threads == 1:
        _begin(one, source)
        yield map
        return
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(config.threads, context, _begin, (one, source))
    try:
        yield pool.map
    except BaseException:  # what the processes are at is of no use any more
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


_worker: dict[str, Any] = {}  # of a collecting process: its configuration and environment


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
    """Drive, and try subsets by rollouts on every so many frames; ``env`` has SAME_STEP autoreset.

    ``policy`` is the policy so far; None at first: then a subset runs to the end of its rollout.
    """
    slots = env.task.slots
    observation, info = env.reset(seed=int(rng.integers(2**31)))
    idle = env.task.episodes.allow_idle
    drives = BehaviourPolicy(env.num_envs, slots, policy, settings.share, rng, idle)
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
    return joined(parts)


def roll_out(
    task: Task,
    subsets: NDArray[np.bool_],
    policy: SubsetSelector | None,
    settings: RolloutConfig,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What each subset (N, B, S) leads to, from where the N routes of ``task`` are and stay.

    After ``settings.hold`` frames the policy goes on; None: the subset does.

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
    observation = np.zeros(0, np.float32)  # seen after a frame; a hold is of one at least
    for frame, weight in enumerate(weights):
        since = frame - settings.hold
        if policy is not None and since >= 0 and since % ACTION_REPEAT == 0:
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


def learn(
    network: SubsetNetwork,
    seen: Sequence[Samples],
    settings: RolloutConfig,
    rng: np.random.Generator,
) -> float:
    """Fit a network to what rollouts came to; mean loss of the last pass.

    Only differences between the subsets of a state count: from there on the drives are the same.
    """
    observations, subsets, *values = map(torch.from_numpy, joined(seen))
    target = centred(torch.stack(values, dim=2))  # (n, B, 2)

    def loss(batch: torch.Tensor) -> torch.Tensor:
        values_of = network.values(observations[batch])  # (E, b, 2^S, 2)
        index = subsets[batch].unsqueeze(2).expand(len(values_of), -1, -1, 2)
        error = centred(values_of.gather(2, index)) - target[batch]
        return 100.0 * (error**2).mean((1, 2, 3)).sum()

    batches = len(subsets) // settings.batch_size
    total = fit(network, loss, len(subsets), batches, settings, rng, weight_decay=1e-5)
    return total / len(network.ensemble)


def centred(values: torch.Tensor) -> torch.Tensor:
    """Values (..., B, 2) less their mean over the subsets."""
    return values - values.mean(-2, keepdim=True)
