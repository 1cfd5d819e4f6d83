"""A trained selector as a policy: drives any bank, of any number of techniques."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from amusic_agents.learners import Kind
from amusic_agents.learners.driver import NetworkSelector
from amusic_agents.network import NetworkConfig, SelectorNetwork
from amusic_agents.run_folder import read_config, read_selector
from amusic_agents.shipped import shipped
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.policies.protocol import Selector


class TrainedSelector(NetworkSelector[SelectorNetwork]):
    """Runs the techniques that the network would rather run than not."""

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The more likely value of every bit."""
        with torch.no_grad():
            logits: torch.Tensor = self.network.logits(torch.from_numpy(observation))
        return logits.numpy() > 0.0


def load_selector(
    run: str | Path | None = None, *, statistic: str | None = None, allow_idle: bool = False
) -> Selector:
    """Load the selector of a run folder, of whatever algorithm, or the one that ships.

    Args:
        run: the run folder; None: the selector that ships for the statistic.
        statistic: which the selector must be of; None: any, and of those that ship the default's.
        allow_idle: of those that ship, the one that may run nothing on a frame; a run is as it is.

    Raises:
        FileNotFoundError: if the folder or its weights are not there.
        ValueError: if it was trained with another version or statistic, is damaged, or none ships
            for the statistic.
    """
    if run is None:
        run = shipped(statistic or SICSettings.statistic, allow_idle=allow_idle)
    run = Path(run)
    config = read_config(run)
    own = config["versions"]["statistic"]
    if statistic not in (None, own):
        raise ValueError(
            f"{run} was trained with the statistic {own!r}, not {statistic!r}; give another run, or"
            " leave out the statistic"
        )
    kind, network = read_selector(run)
    return kind.selector(network, own, config["environment"])


def learned_from_truth(run: str | Path) -> bool:
    """Whether the selector of a run folder was rewarded for what is true, not for p̂.

    Raises:
        FileNotFoundError: if the folder is not there.
        ValueError: if it was trained with another version, or is damaged.
    """
    training = read_config(Path(run)).get("training")
    return isinstance(training, dict) and training.get("reward") == "ground_truth"


KIND = Kind("selector", NetworkConfig, SelectorNetwork, TrainedSelector)
