"""Weights in our own layout, as they ship: safetensors, described by their metadata.

The tensors have the names of the modules in :mod:`~amusic_gym.techniques.networks`:

- CALC: ``conv1.weight``, ``conv1.bias``, …, ``conv3.bias``;
- NetVLAD: ``backbone.N.weight`` and ``.bias``, ``pool.assignment.weight`` (K, C), where there is
  one ``pool.assignment.bias``, ``pool.centroids`` (K, C), and with whitening ``whitening.weight``
  (P, K·C) and ``.bias``.

They are float32 or float16 (and are used as float32). The metadata has one entry, ``amusic_gym``
(one, since safetensors writes several in random order): JSON of

- ``technique``: ``"CALC"`` or ``"NetVLAD"``; ``format_version``: 1;
- ``training``: how the weights were made, in plain words;
- NetVLAD's ``widths`` and ``preparation``: the fields of ``NetVLADWidths`` and ``Preparation``.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

from amusic_gym.techniques.networks import CALCEncoder, NetVLADNetwork
from amusic_gym.techniques.preparation import Preparation
from amusic_gym.techniques.weight_files import write_weights


def save_calc(path: str | Path, encoder: CALCEncoder, *, training: str, half: bool = False) -> Path:
    """Write CALC's weights, whole or not at all; the same weights give the same bytes.

    Raises:
        ValueError: for weights that are not finite, as float16 if that is asked for.
    """
    return _save(path, encoder, {"technique": "CALC", "training": training}, half)


def save_netvlad(
    path: str | Path,
    network: NetVLADNetwork,
    preparation: Preparation,
    *,
    training: str,
    half: bool = False,
) -> Path:
    """Write NetVLAD's weights as ``.safetensors``; batch normalisation is folded into convolutions.

    ``preparation`` is what was done to the images it learned from, ``training`` says in plain words
    how. With ``half`` float16 is stored, which takes half the room.

    Raises:
        ValueError: for weights that are not finite, as float16 if that is asked for.
    """
    description = {
        "technique": "NetVLAD",
        "training": training,
        "widths": asdict(network.widths),
        "preparation": asdict(preparation),
    }
    return _save(path, network.folded(), description, half)


def _save(path: str | Path, network: nn.Module, description: dict[str, Any], half: bool) -> Path:
    arrays = {}
    for name, tensor in network.state_dict().items():
        with np.errstate(over="ignore"):
            array = np.ascontiguousarray(tensor.cpu().numpy(), np.float16 if half else np.float32)
        if not np.isfinite(array).all():
            raise ValueError(
                f"layer {name} holds NaN or infinite numbers as {array.dtype}; "
                "train again" + (", or save without half" if half else "")
            )
        arrays[name] = array
    return write_weights(path, arrays, description)
