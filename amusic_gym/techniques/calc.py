"""CALC: a convolutional auto-encoder that learned to give HOG from warped images (Merrill 2018)."""

import warnings
from functools import partial
from pathlib import Path

import torch
from torch.nn import functional as F  # noqa: N812 (its usual name)

from amusic_gym.techniques.networks import CALCEncoder, load_layers
from amusic_gym.techniques.preparation import prepare_calc
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique
from amusic_gym.techniques.weight_files import WeightFile, read_weights, shipped
from amusic_gym.techniques.weight_readers import FLOOR_POOLING


class CALC(Technique):
    """CALC's encoder on the equalised grey image at 160×120; descriptors of 1064 values, cosine.

    Args:
        weights: a file with the layers ``conv1``, ``conv2`` and ``conv3``: the public
            ``calc.caffemodel``, a PyTorch port (``conv1.weight``, …, also below a prefix), an
            ONNX export, or the same in .npz, .mat or .safetensors; the decoder's layers are
            ignored. None: the weights that ship, which were trained for this package and are not
            the public ones.

    Some ONNX exports pool in floor mode and give 936 values. Their weights are the same; they are
    used with Caffe's ceil mode, and a warning says so.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for a file that is damaged, or whose layers are not CALC's.
    """

    name = "CALC"

    def __init__(self, weights: str | Path | None = None) -> None:
        file = read_weights(shipped("calc") if weights is None else weights)
        self._digest = file.digest
        self._encoder = load_calc(file)

    def parameters(self) -> Parameters:
        """The digest of the weights' file, and the input's size."""
        return {"weights": self._digest, "width": 160, "height": 120}

    def describe(self, image: Image) -> Descriptor:
        """(1064,) of length 1; all zeros where the network gives nothing."""
        grey = torch.from_numpy(prepare_calc(image)).unsqueeze(0)  # (1, 1, 120, 160)
        with torch.inference_mode():
            descriptor: Descriptor = F.normalize(self._encoder(grey))[0].numpy()
        return descriptor


def load_calc(file: WeightFile) -> CALCEncoder:
    """The encoder with a file's weights; refuses the first layer that does not fit."""
    file.description(CALC.name)  # refuses what another technique saved
    part = file.part(CALC.name, "conv1.weight")
    if FLOOR_POOLING in file.metadata:
        warnings.warn(
            f"{file.path} pools in floor mode, which gives 936 values; its weights are used with "
            "ceil mode, 1064 values, as in CALC's own network",
            stacklevel=3,
        )
    return load_layers(CALCEncoder, partial(part.layer, CALC.name))
