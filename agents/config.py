"""How a selector is trained, and how a run folder stores it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from agents.evaluation import Evaluation
from agents.network import NetworkConfig
from agents.run_folder import CONFIG, read_config, versions
from amusic_gym import __version__
from amusic_gym.settings import SICSettings

HIGHEST_SEED = 1_000_000_000
"""Seeds beyond would draw the held-out routes for training."""

_LEAST = {
    **dict.fromkeys(("timesteps", "n_envs", "pool", "n_steps", "epochs"), 1),
    **dict.fromkeys(("evaluate_every", "held_out"), 1),
    "batch_size": 2,  # PPO normalises the advantages of a batch
}

MOST_ROUTES = 65_536
"""Routes side by side; more would take memory by the hundred gigabytes."""


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
        batch_size: frames per gradient step, at most.
        epochs: passes over the frames of an update.
        learning_rate: at the start; falls linearly to zero.
        discount: of later rewards, per frame.
        gae_lambda: of the generalised advantage estimate.
        entropy: weight of the entropy bonus.
        evaluate_every: frames between two evaluations, each followed by a checkpoint.
        held_out: simulated routes of an evaluation.
        network: sizes of the network.

    Raises:
        ValueError: for a number out of range or an unknown statistic.
    """

    timesteps: int = 1_000_000
    seed: int = 0
    n_envs: int = 64
    statistic: str = SICSettings.statistic
    compute_weights: tuple[float, float] = (0.03, 3.0)
    pool: int = 256
    n_steps: int = 64
    batch_size: int = 1024
    epochs: int = 4
    learning_rate: float = 5e-4
    discount: float = 0.95
    gae_lambda: float = 0.9
    entropy: float = 0.01
    evaluate_every: int = 200_000
    held_out: int = 16
    network: NetworkConfig = field(default_factory=NetworkConfig)

    def __post_init__(self) -> None:
        """Refuse what no training can use."""
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise ValueError(f"{name} is {value!r}; give a whole number >= {least}")
        if self.n_envs > MOST_ROUTES:
            raise ValueError(f"n_envs is {self.n_envs}; give at most {MOST_ROUTES}")
        if not isinstance(self.seed, int) or not 0 <= self.seed <= HIGHEST_SEED:
            raise ValueError(f"seed is {self.seed!r}; give a whole number from 0 to {HIGHEST_SEED}")
        if self.rollout < 2:
            raise ValueError("n_steps * n_envs is 1; raise one of them: an update needs 2 frames")
        SICSettings(statistic=self.statistic)

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
        "environment": {},
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
        values["compute_weights"] = tuple(values["compute_weights"])
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
