"""A trained selector as a policy: drives any bank, of any number of techniques."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from amusic_agents.config import NetworkConfig, TrainingConfig
from amusic_agents.network import NetworkSelector, SelectorNetwork
from amusic_agents.reselect import ReselectSelector
from amusic_agents.run_folder import SELECTOR, check_layers, read_config, read_tensors
from amusic_agents.shipped import shipped
from amusic_agents.subsets import SubsetSelector
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.utils.names import suggest
from amusic_gym.utils.reading import parse_json


class TrainedSelector(NetworkSelector):
    """Runs the techniques that the network would rather run than not."""

    kind = "selector"
    sizes_type = NetworkConfig
    network_type = SelectorNetwork

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """The more likely value of every bit."""
        with torch.inference_mode():
            logits: torch.Tensor = self.network.logits(self.seen(observation))
        return logits.numpy() > 0.0


KINDS: dict[str, type[NetworkSelector]] = {
    each.kind: each for each in (TrainedSelector, SubsetSelector, ReselectSelector)
}
"""Kind of a selector, as the file of its weights names it → the policy."""


def load_selector(
    run: str | Path | None = None, *, statistic: str | None = None, allow_idle: bool = False
) -> NetworkSelector:
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
    path = run / SELECTOR
    tensors, metadata = read_tensors(path)
    try:
        sizes = parse_json(metadata["network"].encode(), path, "train again")
        name = sizes.pop("kind", TrainedSelector.kind)
        if name not in KINDS:
            raise ValueError(suggest("kind of selector", name, KINDS))
        kind = KINDS[name]
        network = kind.network_type(kind.sizes_type(**sizes))
    except (KeyError, TypeError, ValueError, RuntimeError, ArithmeticError) as error:
        raise ValueError(f"{path} holds no selector ({error}); train again") from error
    check_layers(path, tensors, network.state_dict())
    network.load_state_dict(tensors)
    selector = kind(network.eval(), own, config["environment"])
    selector.compute_weights = acting_weights(run, config)
    return selector


def acting_weights(run: Path, config: Mapping[str, Any]) -> tuple[float, float] | None:
    """Range of λ that a run's selector acts at; None where its training does not say.

    Raises:
        ValueError: for a range that no training has.
    """
    training = config.get("training")
    if not isinstance(training, dict) or training.get("compute_weights") is None:
        return None
    names = ("compute_weights", "highest_weight")
    given = {name: training[name] for name in names if name in training}
    try:
        given["compute_weights"] = tuple(given["compute_weights"])
        return TrainingConfig(**given).acting_weights
    except (TypeError, ValueError) as error:
        raise ValueError(f"{run} is damaged ({error}); train the selector again") from error


def learned_from_truth(run: str | Path) -> bool:
    """Whether the selector of a run folder was rewarded for what is true, not for p̂.

    Raises:
        FileNotFoundError: if the folder is not there.
        ValueError: if it was trained with another version, or is damaged.
    """
    training = read_config(Path(run)).get("training")
    return isinstance(training, dict) and training.get("reward") == "ground_truth"
