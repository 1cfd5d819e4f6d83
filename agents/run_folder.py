"""A trained selector on disk: weights as safetensors, everything else as JSON and CSV, no pickle.

Layout of a run folder::

    config.json             arguments of the training, versions, best evaluation
    selector.safetensors    the best selector so far
    checkpoint.safetensors  weights, optimiser and random state of the last checkpoint
    evaluation.csv          timesteps, score, accuracy, compute at every evaluation
    progress.csv, events.*  Stable-Baselines3's log and TensorBoard's
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from agents.network import VERSION as NETWORK_VERSION
from agents.network import NetworkConfig, SelectorNetwork
from amusic_gym.observation import VERSION as OBSERVATION_VERSION
from amusic_gym.trace import write_whole

FORMAT_VERSION = 1
CONFIG = "config.json"
SELECTOR = "selector.safetensors"
CHECKPOINT = "checkpoint.safetensors"

Tensors = dict[str, torch.Tensor]


def versions(statistic: str) -> dict[str, Any]:
    """What stored weights depend on."""
    return {
        "format": FORMAT_VERSION,
        "observation": OBSERVATION_VERSION,
        "network": NETWORK_VERSION,
        "statistic": statistic,
    }


def write_config(run: Path, config: dict[str, Any]) -> None:
    """Write ``config.json``, whole or not at all."""
    write_whole(run / CONFIG, (json.dumps(config, indent=1) + "\n").encode())


def read_config(run: Path) -> dict[str, Any]:
    """Read and check ``config.json``.

    Raises:
        FileNotFoundError: if the folder is not one of a training.
        ValueError: for a file that is no JSON, or one of another version.
    """
    path = run / CONFIG
    if not path.is_file():
        raise FileNotFoundError(f"{run} is no run folder: {CONFIG} is missing; train one first")
    try:
        config: dict[str, Any] = json.loads(path.read_text("utf-8"))
        stored = config["versions"]
    except (json.JSONDecodeError, KeyError, UnicodeDecodeError, TypeError) as error:
        raise ValueError(f"{path} is damaged ({error}); train the selector again") from error
    here = versions(stored.get("statistic", "?"))
    for name, value in here.items():
        if stored.get(name) != value:
            raise ValueError(
                f"{run} was trained with {name} version {stored.get(name)}, this program has"
                f" {value}; train the selector again"
            )
    return config


def write_tensors(path: Path, tensors: Tensors, metadata: dict[str, str]) -> None:
    """Write tensors and their metadata as one file, whole or not at all."""
    kept = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    write_whole(path, save(kept, metadata))


def read_tensors(path: Path) -> tuple[Tensors, dict[str, str]]:
    """Read tensors and metadata.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no safetensors file, or a truncated one.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; train the selector first")
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return tensors, file.metadata() or {}
    except SafetensorError as error:
        raise ValueError(f"{path} is no whole safetensors file ({error}); train again") from error


def write_selector(run: Path, network: SelectorNetwork, config: NetworkConfig) -> None:
    """Store a network as the run's selector."""
    metadata = {"network": json.dumps(asdict(config))}
    write_tensors(run / SELECTOR, dict(network.state_dict()), metadata)


def read_selector(run: Path) -> SelectorNetwork:
    """Load the run's selector.

    Raises:
        ValueError: for weights of other names or shapes, naming the first.
    """
    path = run / SELECTOR
    tensors, metadata = read_tensors(path)
    try:
        config = NetworkConfig(**json.loads(metadata["network"]))
    except (KeyError, TypeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} holds no selector ({error}); train again") from error
    network = SelectorNetwork(config)
    expected = network.state_dict()
    for name in sorted(expected.keys() | tensors.keys()):
        have, want = tensors.get(name), expected.get(name)
        if have is None or want is None or have.shape != want.shape:
            raise ValueError(
                f"{path}: layer {name!r} has shape {None if have is None else tuple(have.shape)},"
                f" the network needs {None if want is None else tuple(want.shape)}; train again"
            )
        if not torch.isfinite(have).all():
            raise ValueError(f"{path}: layer {name!r} holds NaN or infinity; train again")
    network.load_state_dict(tensors)
    return network.eval()
