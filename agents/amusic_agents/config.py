"""How a selector is trained, and how a run folder stores it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from amusic_agents.evaluation import Evaluation
from amusic_agents.learners import ALGORITHMS
from amusic_agents.network import NetworkConfig
from amusic_agents.run_folder import CONFIG, read_config, versions
from amusic_gym import __version__
from amusic_gym.envs.rewards import REWARDS
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.routes.simulate import Simulation, population
from amusic_gym.utils.checks import flag, number, share, whole
from amusic_gym.utils.names import suggest

HIGHEST_SEED = 1_000_000_000
"""Seeds beyond would draw the held-out routes for training."""

_LEAST = {
    "batch_size": 2,  # PPO normalises the advantages of a batch
    "subsets": 4,
    "frozen_updates": 0,
}
"""Of whole numbers, where it is not 1."""

_SHARES = ("teacher_share", "share", "discount", "reward_discount", "gae_lambda")

MOST_ROUTES = 65_536
"""Routes side by side; more would take memory by the hundred gigabytes."""


WARM_START: dict[str, Any] = {"entropy": 0.001, "learning_rate": 4e-4, "frozen_updates": 8}
"""Defaults of PPO that begins from weights that can drive already: it must not undo them."""

DEFAULTS: dict[str, dict[str, Any]] = {
    "imitation+ppo": WARM_START,
    "rollouts": {"n_envs": 48, "pool": 512, "compute_weights": (0.02, 4.0), "held_out": 64},
}
"""Where an algorithm's defaults are not those of PPO from scratch."""


@dataclass(frozen=True)
class ImitationConfig:
    """How a teacher is imitated (DAgger: Ross, Gordon and Bagnell, AISTATS 2011).

    Attributes:
        rounds: of driving and learning; all that was seen before is learned again in each.
        frames: driven in each round, over all routes.
        teacher_share: share of the routes that the teacher drives is this to the power of the
            round: all in the first one.
        epochs: passes over all frames in each round.
        batch_size: frames per gradient step.
        learning_rate: at the start of each round; falls linearly to zero in it.

    Raises:
        ValueError: for a number out of range.
    """

    rounds: int = 8
    frames: int = 32_768
    teacher_share: float = 0.5
    epochs: int = 4
    batch_size: int = 512
    learning_rate: float = 4e-3

    def __post_init__(self) -> None:
        """Refuse what nothing can be learned from."""
        _check_numbers(self)


@dataclass(frozen=True)
class RolloutConfig:
    """How policy iteration tries subsets of techniques (:mod:`amusic_agents.policy_iteration`).

    Attributes:
        iterations: of collecting and learning.
        states: from which subsets are tried in each iteration, over all routes.
        kept: iterations whose states are learned from together, the last ones.
        subsets: tried from each state.
        hold: frames for which a subset runs, before the policy so far goes on.
        horizon: frames of a rollout.
        discount: of later frames in it.
        every: frames of a drive between two states.
        share: of the spells of a drive that the policy so far drives.
        epochs: passes over all states in each iteration.
        batch_size: states per gradient step.
        learning_rate: at the start of each iteration; falls linearly to zero in it.

    Raises:
        ValueError: for a number out of range.
    """

    iterations: int = 7
    states: int = 10_000
    kept: int = 4
    subsets: int = 8
    hold: int = 8
    horizon: int = 80
    discount: float = 0.985
    every: int = 12
    share: float = 0.7
    epochs: int = 12
    batch_size: int = 256
    learning_rate: float = 2e-3

    def __post_init__(self) -> None:
        """Refuse what nothing can be learned from."""
        _check_numbers(self)


@dataclass(frozen=True)
class TrainingConfig:
    """Everything that decides how a selector is trained; the defaults are those of ``train.py``.

    Attributes:
        algorithm: name of the algorithm, out of `amusic_agents.learners.ALGORITHMS`.
        timesteps: frames in all, over all routes; imitation counts its own.
        seed: of routes, weights and draws.
        n_envs: routes side by side.
        threads: that step them, with rollouts processes; what is learned does not depend on it.
        statistic: SIC's statistic.
        carry: whether places are carried on as candidates; None: as the statistic has it.
        discount: whether MuSIC discounts alike rows; None: as the statistic has it.
        allow_idle: whether the selector may run nothing on a frame; by policy iteration only.
        reward: name in `amusic_gym.envs.rewards.REWARDS`; ``"ground_truth"`` learns from what is
            true on the training routes instead of from p̂, which a selector may learn to please.
        compute_weights: range from which every episode draws λ, on a logarithmic scale.
        simulation: name → value or (low, high), of ranges that training routes are drawn from
            instead of those of `amusic_gym.routes.simulate.population`.
        pool: simulated training routes that are drawn from again and again.
        n_steps: frames per route between two updates.
        batch_size: frames per gradient step, at most.
        epochs: passes over the frames of an update.
        learning_rate: at the start; falls linearly to zero.
        reward_discount: of later rewards, per frame.
        gae_lambda: of the generalised advantage estimate.
        entropy: weight of the entropy bonus.
        evaluate_every: frames between two evaluations, each followed by a checkpoint.
        held_out: simulated routes of an evaluation.
        network: sizes of the network of PPO and imitation.
        frozen_updates: updates of PPO in which the critic alone learns; for a warm start.
        warm_start: run folder whose weights PPO begins from; ``train`` notes it here.
        imitation: of a teacher.
        rollouts: of policy iteration.

    Raises:
        ValueError: for a number out of range, or an unknown algorithm or statistic.
    """

    algorithm: str = "ppo"
    timesteps: int = 1_000_000
    seed: int = 0
    n_envs: int = 64
    threads: int = 1
    statistic: str = SICSettings.statistic
    carry: bool | None = SICSettings.carry
    discount: bool | None = SICSettings.discount
    allow_idle: bool = False
    reward: str = "estimated"
    compute_weights: tuple[float, float] = (0.01, 6.0)
    simulation: dict[str, Any] = field(default_factory=dict)
    pool: int = 768
    n_steps: int = 64
    batch_size: int = 1024
    epochs: int = 4
    learning_rate: float = 5e-4
    reward_discount: float = 0.95
    gae_lambda: float = 0.9
    entropy: float = 0.01
    evaluate_every: int = 200_000
    held_out: int = 32
    network: NetworkConfig = field(default_factory=NetworkConfig)
    frozen_updates: int = 0
    warm_start: str | None = None
    imitation: ImitationConfig = field(default_factory=ImitationConfig)
    rollouts: RolloutConfig = field(default_factory=RolloutConfig)

    def __post_init__(self) -> None:
        """Refuse what no training can use."""
        if self.algorithm not in ALGORITHMS:
            raise ValueError(suggest("algorithm", self.algorithm, ALGORITHMS))
        if self.reward not in REWARDS:
            raise ValueError(suggest("reward", self.reward, REWARDS))
        _check_numbers(self)
        if self.n_envs > MOST_ROUTES:
            raise ValueError(f"n_envs is {self.n_envs}; give at most {MOST_ROUTES}")
        whole("seed", self.seed, 0, most=HIGHEST_SEED)
        if self.rollout < 2:
            raise ValueError("n_steps * n_envs is 1; raise one of them: an update needs 2 frames")
        if self.allow_idle and self.algorithm != "rollouts":
            raise ValueError(
                f"algorithm {self.algorithm!r} learns no selector that may idle; leave out"
                " allow_idle, or take 'rollouts'"
            )
        self.environment()
        self.population()

    def environment(self) -> dict[str, bool]:
        """How SIC works besides its statistic, and idling: arguments of the environment.

        Raises:
            ValueError: for an unknown statistic, or what it has no use for.
        """
        settings = SICSettings(self.statistic, carry=self.carry, discount=self.discount)
        idle = {"allow_idle": True} if self.allow_idle else {}
        return {name: bool(getattr(settings, name)) for name in ("carry", "discount")} | idle

    def population(self) -> Simulation:
        """The ranges that training routes are drawn from.

        Raises:
            ValueError: for an unknown range, or a value out of its limits.
        """
        names = [range_.name for range_ in fields(Simulation)]
        for name in self.simulation:
            if name not in names:
                raise ValueError(suggest("range of the simulation", name, names))
        return replace(population(self.statistic), **self.simulation)

    @property
    def rollout(self) -> int:
        """Frames between two updates, over all routes."""
        return self.n_steps * self.n_envs

    @property
    def batch(self) -> int:
        """Largest batch of at most ``batch_size`` frames that divides an update's evenly."""
        largest = min(self.batch_size, self.rollout)
        even = (size for size in range(largest, 1, -1) if self.rollout % size == 0)
        return next(even, largest)


def _check_numbers(config: ImitationConfig | RolloutConfig | TrainingConfig) -> None:
    """Refuse numbers out of range, by the kind of their defaults."""
    for each in fields(config):
        name, value = each.name, getattr(config, each.name)
        if type(each.default) is bool:
            flag(name, value)
        elif type(each.default) is int and name != "seed":
            whole(name, value, _LEAST.get(name, 1))
        elif type(each.default) is float:
            if name in _SHARES:
                share(name, value)
            elif number(name, value, "a number >= 0") < 0.0:
                raise ValueError(f"{name} is {value!r}; give a number >= 0")


def training_config(algorithm: str, **given: Any) -> TrainingConfig:
    """The configuration of an algorithm: its defaults, and what is given.

    Raises:
        ValueError: for an unknown algorithm or a number out of range.
    """
    return TrainingConfig(**{"algorithm": algorithm, **DEFAULTS.get(algorithm, {}), **given})


def stored(
    config: TrainingConfig, banks: Sequence[str | None], best: Evaluation | None
) -> dict[str, Any]:
    """What ``config.json`` holds.

    Args:
        config: the configuration.
        banks: folders of the banks that it trains on, None for one in memory; empty: simulated
            routes.
        best: evaluation of the stored selector.
    """
    return {
        "versions": versions(config.statistic),
        "amusic_gym": __version__,
        "environment": config.environment(),
        "banks": list(banks),
        "training": asdict(config),
        "best": None if best is None else best._asdict(),
    }


def stored_config(out: Path) -> TrainingConfig:
    """The configuration of a run folder.

    Raises:
        FileNotFoundError: if there is no run.
        ValueError: if it is of another version, or damaged.
    """
    config = read_config(out)
    try:
        values = dict(config["training"])
        values["network"] = NetworkConfig(**values["network"])
        values["imitation"] = ImitationConfig(**values["imitation"])
        values["rollouts"] = RolloutConfig(**values["rollouts"])
        values["compute_weights"] = tuple(values["compute_weights"])
        values["simulation"] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in dict(values["simulation"]).items()
        }
        return TrainingConfig(**values)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{out / CONFIG} is damaged ({error}); train the selector again"
        ) from error


def stored_banks(out: Path) -> list[str]:
    """Folders of the banks that a run trains on; empty: simulated routes.

    Raises:
        ValueError: if it was trained on routes that no folder holds.
    """
    banks = read_config(out).get("banks", [])
    if not isinstance(banks, list) or not all(isinstance(bank, str) for bank in banks):
        raise ValueError(f"{out} was trained on routes in memory; give them again to resume")
    return banks
