"""A trained selector as a policy: drives any bank, of any number of techniques."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from agents.learners import Kind
from agents.network import NetworkConfig, SelectorNetwork
from agents.run_folder import read_config, read_selector
from amusic_gym.policy import Needs, Selector


class TrainedSelector:
    """Runs the techniques that the network would rather run than not.

    Args:
        network: the network.
        statistic: SIC's statistic that it was trained on.
        environment: other arguments of the environment that it was trained on.
    """

    def __init__(
        self, network: SelectorNetwork, statistic: str, environment: Mapping[str, Any] | None = None
    ) -> None:
        self.network = network
        self.needs = Needs(statistic=statistic, extra=dict(environment or {}))

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Nothing to forget: what it knows is in the observation."""

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The more likely value of every bit."""
        with torch.no_grad():
            logits: torch.Tensor = self.network.logits(torch.from_numpy(observation))
        return logits.numpy() > 0.0


def load_selector(run: str | Path) -> Selector:
    """Load the selector of a run folder, of whatever algorithm.

    Raises:
        FileNotFoundError: if the folder or its weights are not there.
        ValueError: if it was trained with another version, or is damaged.
    """
    run = Path(run)
    config = read_config(run)
    kind, network = read_selector(run)
    return kind.selector(network, config["versions"]["statistic"], config["environment"])


KIND = Kind("selector", NetworkConfig, SelectorNetwork, TrainedSelector)
