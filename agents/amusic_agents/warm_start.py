"""PPO that begins from weights that can drive already, as those of an imitation."""

from __future__ import annotations

from pathlib import Path

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from amusic_agents.config import TrainingConfig
from amusic_agents.learners import learner
from amusic_agents.learners.ppo import network
from amusic_agents.network import PRESENT, WIDTH, SelectorNetwork
from amusic_agents.run_folder import SELECTOR, check_layers, read_config, read_selector
from amusic_gym.envs.observation import observation_size
from amusic_gym.estimation.settings import SICSettings

Start = SelectorNetwork | str | Path
"""Where a warm start's weights come from: a network, or a run folder."""


def starting_network(start: Start, config: TrainingConfig) -> SelectorNetwork:
    """The network to begin from.

    Args:
        start: the network, or the run folder that holds it.
        config: of the training that will begin from it.

    Raises:
        FileNotFoundError: if there is no such run.
        ValueError: for a run of another statistic, carry or discount, or an algorithm with
            another network.
    """
    if (kind := learner(config.algorithm).kind) != "selector":
        raise ValueError(
            f"algorithm {config.algorithm!r} trains a selector of the kind {kind!r}; only ppo"
            " takes a warm start"
        )
    if isinstance(start, SelectorNetwork):
        return start
    run = Path(start)
    stored_config = read_config(run)
    own = stored_config["versions"]["statistic"]
    if own != config.statistic:
        raise ValueError(
            f"{run} was trained with the statistic {own!r}, this training uses"
            f" {config.statistic!r}; give a run of the same"
        )
    for name, value in config.environment().items():
        had = stored_config["environment"].get(name, getattr(SICSettings(own), name))
        if had != value:
            raise ValueError(
                f"{run} was trained with {name} {had}, this training uses {value}; give a run of"
                " the same"
            )
    stored, found = read_selector(run)
    if not isinstance(found, SelectorNetwork):
        raise ValueError(
            f"{run} holds a selector of the kind {stored.name!r}; give a run of ppo or imitation"
        )
    return found


def take_over(model: BaseAlgorithm, start: SelectorNetwork) -> None:
    """Give a model the weights of a network.

    Raises:
        ValueError: for a network of other sizes, naming the first layer.
    """
    own = network(model)
    weights = dict(start.state_dict())
    check_layers(Path("the warm start's") / SELECTOR, weights, own.state_dict())
    own.load_state_dict(weights)


class FreezeActor(BaseCallback):
    """Lets the critic learn alone for some updates, so that it cannot mislead a good actor.

    A new critic is wrong about everything, and so are the advantages that it gives; a few updates
    by them undo an imitation. Everything that a logit depends on stands still meanwhile.

    Args:
        updates: how many, from the beginning of the training.
        rollout: frames between two updates.
    """

    def __init__(self, updates: int, rollout: int) -> None:
        super().__init__()
        self.frames = updates * rollout
        self._actor: list[nn.Parameter] = []

    def _on_training_start(self) -> None:
        self._actor = actor_parameters(network(self.model))

    def _on_rollout_start(self) -> None:
        learns = self.model.num_timesteps >= self.frames
        for parameter in self._actor:
            parameter.requires_grad_(learns)

    def _on_step(self) -> bool:
        return True


def actor_parameters(net: SelectorNetwork) -> list[nn.Parameter]:
    """The parameters that the logits depend on, found by differentiating them."""
    slots = 2
    observation = torch.rand(1, observation_size(slots), generator=torch.Generator().manual_seed(0))
    observation[:, PRESENT : slots * WIDTH : WIDTH] = 1.0
    parameters = list(net.parameters())
    found = torch.autograd.grad(net.logits(observation).sum(), parameters, allow_unused=True)
    return [p for p, gradient in zip(parameters, found, strict=True) if gradient is not None]
