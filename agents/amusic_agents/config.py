"""How a selector is trained: the settings of every algorithm and network, with their checks.

Nothing here loads PyTorch, so that a command line can name the settings at once.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

from amusic_gym.envs.rewards import REWARDS
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.routes.simulate import Simulation, population
from amusic_gym.utils.checks import flag, number, share, whole
from amusic_gym.utils.names import suggest

ALGORITHMS = {
    "ppo": "amusic_agents.ppo:PPOLearner",
    "imitation": "amusic_agents.imitation:ImitationLearner",
    "imitation+ppo": "amusic_agents.ppo:PPOLearner",  # after an imitation
    "rollouts": "amusic_agents.policy_iteration:RolloutLearner",
    "reselect": "amusic_agents.ppo:ReselectLearner",
}
"""Name on the command line → the class that trains, imported when used."""

DEFAULTS: dict[str, dict[str, Any]] = {
    # PPO must not undo what the imitation has learned.
    "imitation+ppo": {"entropy": 0.001, "learning_rate": 4e-4, "frozen_updates": 8},
    "rollouts": {"n_envs": 48, "pool": 512, "compute_weights": (0.02, 4.0), "held_out": 64},
}
"""Where an algorithm's defaults are not those of PPO from scratch."""

USED_BY = {
    "network": ("ppo", "imitation", "imitation+ppo"),
    "imitation": ("imitation", "imitation+ppo"),
    "rollouts": ("rollouts",),
}
"""Settings within those of a training → the algorithms that have a use for them."""

HIGHEST_SEED = 1_000_000_000  # seeds beyond would draw the held-out routes for training
MOST_ROUTES = 65_536  # routes side by side; more would take memory by the hundred gigabytes
WIDEST = 4096  # largest size of a layer: a damaged file must not fill the memory


def count(default: int, least: int = 1, most: int | None = None) -> int:
    """A whole number in a range, as a field of `Settings`."""
    return checked(default, partial(whole, least=least, most=most))


def amount(default: float) -> float:
    """A number that is not negative, as a field of `Settings`."""
    return checked(default, _at_least_zero)


def _at_least_zero(name: str, value: Any) -> None:
    if number(name, value, "a number >= 0") < 0.0:
        raise ValueError(f"{name} is {value!r}; give a number >= 0")


def _weights(name: str, value: Any) -> None:
    wanted = "(low, high) with 0 < low <= high"
    ends = value if isinstance(value, tuple) and len(value) == 2 else (None, None)
    low, high = (number(name, end, wanted) for end in ends)
    if not 0.0 < low <= high:
        raise ValueError(f"{name} is {value!r}; give {wanted}")


def checked(default: Any, check: Callable[[str, Any], object]) -> Any:
    """A field of `Settings` with its default and its check."""
    return field(default=default, metadata={"check": check})


@dataclass(frozen=True)
class Settings:
    """Base of all settings; raises a ValueError for a value that its field's check refuses."""

    def __post_init__(self) -> None:
        for each in fields(self):
            if "check" in each.metadata:
                each.metadata["check"](each.name, getattr(self, each.name))


@dataclass(frozen=True)
class SetSizes(Settings):
    """Sizes of a network that encodes every technique by the same layers.

    Attributes:
        hidden: width of the hidden layers.
        encoding: length of a technique's encoding.
    """

    hidden: int = count(64, most=WIDEST)
    encoding: int = count(32, most=WIDEST)


@dataclass(frozen=True)
class NetworkConfig(SetSizes):
    """Sizes of the network of PPO and imitation.

    Attributes:
        first_logit: logit that every technique starts with. Above 0, learning begins with most
            techniques running and finds out which to leave out; from 0 or below it often ends
            with the cheapest technique for ever.
    """

    first_logit: float = checked(1.0, partial(number, wanted="a number"))


@dataclass(frozen=True)
class ImitationConfig(Settings):
    """How a teacher is imitated (:mod:`amusic_agents.imitation`).

    Attributes:
        rounds: of driving and learning; all that was seen before is learned again in each.
        frames: driven in each round, over all routes.
        teacher_share: share of the routes that the teacher drives is this to the power of the
            round: all in the first one.
        epochs: passes over all frames in each round.
        batch_size: frames per gradient step.
        learning_rate: at the start of each round; falls linearly to zero in it.
    """

    rounds: int = count(8)
    frames: int = count(32_768)
    teacher_share: float = checked(0.5, share)
    epochs: int = count(4)
    batch_size: int = count(512, least=2)
    learning_rate: float = amount(4e-3)


@dataclass(frozen=True)
class RolloutConfig(Settings):
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
    """

    iterations: int = count(7)
    states: int = count(10_000)
    kept: int = count(4)
    subsets: int = count(8, least=4)
    hold: int = count(8)
    horizon: int = count(80)
    discount: float = checked(0.985, share)
    every: int = count(12)
    share: float = checked(0.7, share)
    epochs: int = count(12)
    batch_size: int = count(256, least=2)
    learning_rate: float = amount(2e-3)


@dataclass(frozen=True)
class TrainingConfig(Settings):
    """Everything that decides how a selector is trained; the defaults are those of ``train.py``.

    Attributes:
        algorithm: name of the algorithm, out of `ALGORITHMS`.
        timesteps: frames in all, over all routes; imitation and rollouts count their own.
        seed: of routes, weights and draws.
        n_envs: routes side by side.
        threads: that step them, with rollouts processes; what is learned does not depend on it.
        statistic: SIC's statistic.
        carry: whether places are carried on as candidates; None: as the statistic has it.
        discount: whether MuSIC discounts alike rows; None: as the statistic has it.
        allow_idle: whether the selector may run nothing on a frame; by policy iteration only.
        reward: name in `amusic_gym.envs.rewards.REWARDS`; ``"ground_truth"`` learns from what is
            true on the training routes instead of from p̂, whose errors a selector may exploit.
        compute_weights: range from which every episode draws λ, on a logarithmic scale.
        highest_weight: λ beyond which the selector acts as at it, where it is within that range,
            whose upper end is learned worst.
        simulation: name → value or (low, high), of ranges that training routes are drawn from
            instead of those of `amusic_gym.routes.simulate.population`.
        pool: simulated training routes that are drawn from again and again.
        n_steps: frames per route between two updates.
        batch_size: frames per gradient step, at most; PPO normalises the advantages of a batch.
        epochs: passes over the frames of an update.
        learning_rate: at the start; falls linearly to zero.
        reward_discount: of later rewards, per frame.
        gae_lambda: of the generalised advantage estimate.
        entropy: weight of the entropy bonus.
        evaluate_every: frames between two evaluations, each followed by a checkpoint.
        held_out: simulated routes of an evaluation.
        network: sizes of the network of PPO and imitation.
        frozen_updates: updates of PPO in which the critic alone learns; after an imitation.
        imitation: of a teacher.
        rollouts: of policy iteration.
    """

    algorithm: str = "ppo"
    timesteps: int = count(1_000_000)
    seed: int = count(0, least=0, most=HIGHEST_SEED)
    n_envs: int = count(64)
    threads: int = count(1)
    statistic: str = SICSettings.statistic
    carry: bool | None = SICSettings.carry
    discount: bool | None = SICSettings.discount
    allow_idle: bool = checked(False, flag)
    reward: str = "estimated"
    compute_weights: tuple[float, float] = checked((0.01, 6.0), _weights)
    highest_weight: float = amount(1e6)
    simulation: dict[str, Any] = field(default_factory=dict)
    pool: int = count(768)
    n_steps: int = count(64)
    batch_size: int = count(1024, least=2)
    epochs: int = count(4)
    learning_rate: float = amount(5e-4)
    reward_discount: float = checked(0.95, share)
    gae_lambda: float = checked(0.9, share)
    entropy: float = amount(0.01)
    evaluate_every: int = count(200_000)
    held_out: int = count(32)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    frozen_updates: int = count(0, least=0)
    imitation: ImitationConfig = field(default_factory=ImitationConfig)
    rollouts: RolloutConfig = field(default_factory=RolloutConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, known in (("algorithm", ALGORITHMS), ("reward", REWARDS)):
            if getattr(self, name) not in known:
                raise ValueError(suggest(name, getattr(self, name), known))
        if self.n_envs > MOST_ROUTES:
            raise ValueError(f"n_envs is {self.n_envs}; give at most {MOST_ROUTES}")
        if self.rollout < 2:
            raise ValueError("n_steps * n_envs is 1; raise one of them: an update needs 2 frames")
        if self.allow_idle and self.algorithm != "rollouts":
            raise ValueError(
                f"algorithm {self.algorithm!r} learns no selector that may idle; leave out"
                " allow_idle, or take 'rollouts'"
            )
        self.environment()
        self.population()

    @property
    def acting_weights(self) -> tuple[float, float]:
        """Range of λ that the selector acts at; at any other it acts as at the nearest end."""
        low, high = self.compute_weights
        return low, max(low, min(high, self.highest_weight))

    def environment(self) -> dict[str, Any]:
        """How SIC works besides its statistic, and idling: arguments of the environment.

        Raises:
            ValueError: for an unknown statistic, or what it has no use for.
        """
        settings = SICSettings(self.statistic, carry=self.carry, discount=self.discount)
        idle = {"allow_idle": True} if self.allow_idle else {}
        return {name: bool(getattr(settings, name)) for name in ("carry", "discount")} | idle

    def population(self) -> Simulation:
        """The ranges that training routes are drawn from; refuses an unknown one, or its value."""
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


def training_config(algorithm: str, **given: Any) -> TrainingConfig:
    """The configuration of an algorithm: its defaults, and what is given, if that fits."""
    return TrainingConfig(**{"algorithm": algorithm, **DEFAULTS.get(algorithm, {}), **given})


def with_values(settings: Any, values: Mapping[str, Any]) -> Any:
    """Settings with other values, as JSON has them: lists for ranges, objects for settings within.

    Raises:
        ValueError: for an unknown name or a value that is refused.
    """
    names = [each.name for each in fields(settings)]
    changes = {}
    for name, value in values.items():
        if name not in names:
            raise ValueError(suggest("setting", name, names))
        own = getattr(settings, name)
        if isinstance(own, Settings):
            if not isinstance(value, Mapping):
                raise ValueError(f"{name} is {value!r}; give an object with its settings")
            changes[name] = with_values(own, value)
        elif isinstance(value, Mapping):
            changes[name] = {key: plain(each) for key, each in value.items()}
        else:
            changes[name] = plain(value)
    return replace(settings, **changes)


def plain(value: Any) -> Any:
    """A value of JSON as a setting has it: a tuple for a list."""
    return tuple(value) if isinstance(value, list) else value


def leaves(settings: Settings, prefix: str = "") -> dict[str, Any]:
    """Every setting by name, those within others as ``network.hidden``."""
    found: dict[str, Any] = {}
    for each in fields(settings):
        value = getattr(settings, each.name)
        nested = isinstance(value, Settings)
        found |= leaves(value, f"{prefix}{each.name}.") if nested else {prefix + each.name: value}
    return found


def with_leaves(settings: Any, values: Mapping[str, Any]) -> Any:
    """Settings with other values, named as `leaves` names them; raises as `with_values`."""
    return with_values(settings, nested(values))


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """``{"network.hidden": 32}`` as ``{"network": {"hidden": 32}}``."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        *outer, last = name.split(".")
        into = found
        for each in outer:
            into = into.setdefault(each, {})
        into[last] = value
    return found
