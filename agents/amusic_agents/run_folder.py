"""A trained selector on disk: weights as safetensors, everything else as JSON and CSV, no pickle.

Layout of a run folder::

    config.json             arguments of the training, banks, versions, best evaluation
    selector.safetensors    the best selector so far
    checkpoint.safetensors  weights, optimiser and random state of the last checkpoint, and the
                            best weights
    evaluation.csv          timesteps, score, accuracy, compute at every evaluation
    progress.csv, events.*  Stable-Baselines3's log and TensorBoard's; progress-N.csv after a
                            resume at N timesteps

No file of another program is loaded, above all no zip of Stable-Baselines3: those hold pickles.
"""

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import nn

from amusic_agents.config import TrainingConfig, with_values
from amusic_agents.evaluation import Evaluation
from amusic_agents.network import VERSION as NETWORK_VERSION
from amusic_gym import __version__
from amusic_gym.envs.observation import VERSION as OBSERVATION_VERSION
from amusic_gym.estimation.settings import STATISTICS
from amusic_gym.utils.escaping import CsvWriter
from amusic_gym.utils.reading import parse_json, read_json
from amusic_gym.utils.storage import write_whole

FORMAT_VERSION = 1
CONFIG = "config.json"
SELECTOR = "selector.safetensors"
CHECKPOINT = "checkpoint.safetensors"
EVALUATIONS = "evaluation.csv"
BEST = "best."  # prefix of the selector's weights in a checkpoint
FIRST_KIND = "selector"  # of a selector whose weights name no kind

ENVIRONMENT = ("candidates", "history", "gamma", "carry", "discount", "allow_idle")
"""Arguments of the environment that a run may set besides the statistic."""

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
    config: dict[str, Any] = read_json(path, "train the selector again")
    try:
        stored = dict(config["versions"])
        environment = dict(config["environment"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is damaged ({error}); train the selector again") from error
    if stored.get("statistic") not in STATISTICS:
        raise ValueError(
            f"{run} was trained with the statistic {stored.get('statistic')!r}, this program has"
            f" {' and '.join(STATISTICS)}; train the selector again"
        )
    if unknown := sorted(environment.keys() - set(ENVIRONMENT)):
        raise ValueError(
            f"{path} asks for {unknown[0]!r} of the environment, known are"
            f" {', '.join(ENVIRONMENT)}; train the selector again"
        )
    for name, value in versions(stored["statistic"]).items():
        if stored.get(name) != value:
            raise ValueError(
                f"{run} was trained with {name} version {stored.get(name)}, this program has"
                f" {value}; train the selector again"
            )
    return config


def stored(
    config: TrainingConfig, banks: Sequence[str | None], best: Evaluation | None
) -> dict[str, Any]:
    """What ``config.json`` holds.

    ``banks`` are folders of the banks that it trains on, None for one in memory; none: simulated
    routes. ``best`` is the evaluation of the stored selector.
    """
    return {
        "versions": versions(config.statistic),
        "amusic_gym": __version__,
        "environment": config.environment(),
        "banks": list(banks),
        "training": asdict(config),
        "best": None if best is None else best._asdict(),
    }


def stored_config(run: Path) -> TrainingConfig:
    """The configuration of a run folder.

    Raises:
        FileNotFoundError: if there is no run.
        ValueError: if it is of another version, or damaged.
    """
    config = read_config(run)
    try:
        values = dict(config["training"])
        values.pop("warm_start", None)  # of an earlier version
        return with_values(TrainingConfig(), values)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{run / CONFIG} is damaged ({error}); train the selector again"
        ) from error


def stored_banks(run: Path) -> list[str]:
    """Folders of the banks that a run trains on, none for simulated routes; refuses others."""
    banks = read_config(run).get("banks", [])
    if not isinstance(banks, list) or not all(isinstance(bank, str) for bank in banks):
        raise ValueError(f"{run} was trained on routes in memory; give them again to resume")
    return banks


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file, whole or not at all."""
    table = io.StringIO()
    writer = CsvWriter(table)
    writer.writerow(header)
    writer.writerows(rows)
    write_whole(path, table.getvalue().encode())


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


def read_list(path: Path, metadata: Mapping[str, str], name: str) -> list[Any]:
    """The list that the metadata ``name`` of a file of tensors holds.

    Raises:
        KeyError: where there is none.
        ValueError: where it is no list of plain finite values.
    """
    return parse_json(metadata[name].encode(), path, "train again", list)


def part(tensors: Tensors, prefix: str) -> Tensors:
    """The tensors whose names begin with a prefix, without it."""
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def write_selector(run: Path, network: nn.Module, sizes: Any, kind: str = FIRST_KIND) -> None:
    """Store a network as the run's selector; ``kind`` is one of `amusic_agents.selector.KINDS`."""
    about = asdict(sizes) if kind == FIRST_KIND else {"kind": kind, **asdict(sizes)}
    # One entry: safetensors writes several in any order, and the same weights are the same bytes.
    write_tensors(run / SELECTOR, dict(network.state_dict()), {"network": json.dumps(about)})


def check_layers(path: Path, tensors: Tensors, expected: Mapping[str, torch.Tensor]) -> None:
    """Refuse weights that are not a network's, naming the first other layer, or one with NaN."""
    for name in sorted(expected.keys() | tensors.keys()):
        have, want = tensors.get(name), expected.get(name)
        if have is None or want is None or (have.shape, have.dtype) != (want.shape, want.dtype):
            raise ValueError(
                f"{path}: layer {name!r} is {_kind(have)}, the network needs {_kind(want)};"
                f" train again"
            )
        if not torch.isfinite(have).all():
            raise ValueError(f"{path}: layer {name!r} holds NaN or infinity; train again")


def _kind(tensor: torch.Tensor | None) -> str:
    if tensor is None:
        return "none"
    return f"{tuple(tensor.shape)} {str(tensor.dtype).removeprefix('torch.')}"
