"""Small files for techniques that need one of the user's."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import weight_cases
from numpy.typing import NDArray
from torch import nn

from amusic_gym.techniques.fabmap_model import ChowLiuTree

PLAIN = "size = [24, 32]\n"


class Small(nn.Module):
    """Several outputs: the second is the descriptor."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(5)
        self.conv = nn.Conv2d(3, 6, 5, stride=4)

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        y = torch.relu(self.conv(x))
        return y, y.mean((2, 3))


def torchscript(folder: Path, recipe: str = PLAIN + "output = 1\n") -> Path:
    path = folder / "small.pt"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.jit.save(torch.jit.script(Small()), path)
    path.with_suffix(".toml").write_text(recipe)
    return path


def onnx_file(folder: Path, recipe: str = PLAIN, operator: str = "Relu") -> Path:
    from onnx import TensorProto, helper, numpy_helper, save_model

    conv = Small().conv.state_dict()
    weights = [numpy_helper.from_array(conv[name].numpy(), name) for name in ("weight", "bias")]
    nodes = [
        helper.make_node("Conv", ["x", "weight", "bias"], ["c"], strides=[4, 4]),
        helper.make_node(operator, ["c"], ["r"]),
        helper.make_node("GlobalAveragePool", ["r"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], ["descriptor"]),
    ]
    values = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in (("x", ["n", 3, "h", "w"]), ("descriptor", ["n", 6]))
    ]
    graph = helper.make_graph(nodes, "small", values[:1], values[1:], weights)
    opset = [helper.make_opsetid("", 17)]
    path = folder / "small.onnx"
    save_model(helper.make_model(graph, opset_imports=opset, ir_version=9), path)
    path.with_suffix(".toml").write_text(recipe)
    return path


def amosnet(folder: Path, seed: int = 0) -> Path:
    """AMOSNet's file, as Caffe writes it, of random numbers."""
    path = folder / f"amosnet-{seed}.caffemodel"
    path.write_bytes(
        b"".join(
            weight_cases.caffe_layer(name, "Convolution", arrays)
            for name, arrays in amosnet_layers(seed).items()
        )
    )
    return path


def amosnet_layers(seed: int = 0) -> dict[str, list[NDArray[Any]]]:
    """Weights and biases by layer, in Caffe's shapes, and a layer that is not needed."""
    rng = np.random.default_rng(seed)
    shapes = {
        "conv1": (96, 3, 11, 11),
        "conv2": (256, 48, 5, 5),
        "conv3": (384, 256, 3, 3),
        "conv4": (384, 192, 3, 3),
        "conv5": (256, 192, 3, 3),
        "fc8_new": (5, 7),
    }
    return {
        name: [
            (rng.standard_normal(shape) * (2 / np.prod(shape[1:])) ** 0.5).astype(np.float32),
            (rng.standard_normal(shape[0]) * 0.1).astype(np.float32),
        ]
        for name, shape in shapes.items()
    }


def vgg16(folder: Path, prefix: str = "") -> Path:
    """A narrow VGG16 as PyTorch names its layers."""
    arrays = weight_cases.netvlad_arrays(0)
    convolutions = {
        name.replace("encoder.", ""): array
        for name, array in arrays.items()
        if name.startswith("encoder.")
    }
    return weight_cases.save_torch(folder / "vgg16.pth", convolutions, prefix)


def fabmap(folder: Path, words: int = 40) -> Path:
    """A vocabulary of random words, and a tree over random images."""
    rng = np.random.default_rng(0)
    vocabulary = rng.random((words, 128)) ** 4
    vocabulary /= np.linalg.norm(vocabulary, axis=1, keepdims=True)
    tree = ChowLiuTree.learn(rng.random((60, words)) < 0.4)
    return tree.save(folder / "fabmap.safetensors", vocabulary.astype(np.float32), "none")


MADE: dict[str, Callable[[Path], tuple[str, Path | None]]] = {
    "torchscript": lambda folder: (f"torchscript:{torchscript(folder)}", None),
    "onnx": lambda folder: (f"onnx:{onnx_file(folder)}", None),
    "rmac": lambda folder: ("rmac", vgg16(folder)),
    "fabmap": lambda folder: ("fabmap", fabmap(folder)),
    "amosnet": lambda folder: ("amosnet", amosnet(folder)),
    "hybridnet": lambda folder: ("hybridnet", amosnet(folder, seed=1)),
}
"""Technique -> in a folder, its name with all that belongs to it, and its weights file."""
