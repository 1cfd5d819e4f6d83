"""Small weights of CALC and NetVLAD, and public files' structures around them, made byte by byte.

NetVLAD's networks here are VGG16 with few channels: same layers, names and shapes otherwise.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

CALC_SHAPES = {"conv1": (64, 1, 5, 5), "conv2": (128, 64, 4, 4), "conv3": (4, 128, 3, 3)}
VGG16_NUMBERS = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
NARROW = (2, 3, 4, 3, 5, 4, 3, 4, 5, 6, 5, 4, 6)
CHANNELS, CLUSTERS, WHITENED = 6, 4, 5


def calc_arrays(seed: int = 0) -> Arrays:
    """Layers of CALC, strong enough for the response normalisation to matter."""
    rng = np.random.default_rng(seed)
    arrays: Arrays = {}
    for (name, shape), gain in zip(CALC_SHAPES.items(), (60.0, 2.0, 2.0), strict=True):
        spread = gain / np.sqrt(np.prod(shape[1:]))
        arrays[f"{name}.weight"] = (rng.standard_normal(shape) * spread).astype(np.float32)
        arrays[f"{name}.bias"] = rng.standard_normal(shape[0]).astype(np.float32)
    return arrays


def image(seed: int = 0, height: int = 90, width: int = 120) -> NDArray[np.uint8]:
    """A colour image of soft shapes and some noise."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (height // 15, width // 15, 3))
    soft = np.kron(coarse, np.ones((15, 15, 1)))
    return np.clip(soft + rng.normal(0, 12, soft.shape), 0, 255).astype(np.uint8)


# --- Caffe -----------------------------------------------------------------------------------


def varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def field(number: int, content: bytes | str | int) -> bytes:
    """One field of a protocol buffer: a number, or bytes with their length in front."""
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    content = content.encode() if isinstance(content, str) else content
    return varint(number << 3 | 2) + varint(len(content)) + content


def blob(array: NDArray[Any], old: bool = False) -> bytes:
    values = field(5, array.astype("<f4").tobytes())
    if old:  # num, channels, height, width; a bias is 1×1×1×N
        sizes = (1,) * (4 - array.ndim) + array.shape
        return b"".join(field(i + 1, size) for i, size in enumerate(sizes)) + values
    return values + field(7, field(1, b"".join(map(varint, array.shape))))


def caffe_layer(name: str, kind: str, arrays: list[NDArray[Any]], old: bool = False) -> bytes:
    if old:  # V1LayerParameter: the type is a number, 4 a convolution
        parts = [field(4, name), field(5, 4), *(field(6, blob(a, old)) for a in arrays)]
        return field(2, b"".join(parts))
    parts = [field(1, name), field(2, kind), *(field(7, blob(a)) for a in arrays)]
    return field(100, b"".join(parts))


def caffemodel(arrays: Mapping[str, NDArray[Any]], old: bool = False) -> bytes:
    """A trained CALC as Caffe writes it: encoder, layers without weights, and decoder."""
    rng = np.random.default_rng(9)
    convolutions = [
        caffe_layer(
            name, "Convolution", [arrays[f"{name}.weight"], arrays[f"{name}.bias"]], old=old
        )
        + caffe_layer(f"relu{name[-1]}", "ReLU", [], old=old)
        for name in CALC_SHAPES
    ]
    decoder = [rng.standard_normal((3, 1064)), rng.standard_normal(3)]
    fc4 = caffe_layer("fc4", "InnerProduct", decoder, old=old)
    return field(1, "calc") + b"".join(convolutions) + fc4


# --- NetVLAD ---------------------------------------------------------------------------------


def netvlad_arrays(
    seed: int = 0, whitened: int | None = WHITENED, gain: float = 1.4, bias: bool = False
) -> Arrays:
    """A narrow VGG16 with NetVLAD under the names of PyTorch's ports; whitening as Patch-NetVLAD.

    Its shapes are those of the public files: assignment (K, C, 1, 1), whitening (P, K·C, 1, 1).
    """
    rng = np.random.default_rng(seed)
    arrays: Arrays = {}
    width = 3
    for number, out in zip(VGG16_NUMBERS, NARROW, strict=True):
        spread = gain / np.sqrt(9 * width)
        arrays[f"encoder.{number}.weight"] = rng.standard_normal((out, width, 3, 3)) * spread
        arrays[f"encoder.{number}.bias"] = rng.standard_normal(out) * 0.3
        width = out
    arrays["pool.conv.weight"] = rng.standard_normal((CLUSTERS, CHANNELS, 1, 1)) * 3
    if bias:
        arrays["pool.conv.bias"] = rng.standard_normal(CLUSTERS)
    arrays["pool.centroids"] = rng.standard_normal((CLUSTERS, CHANNELS)) * 0.4
    if whitened is not None:
        flat = CLUSTERS * CHANNELS
        arrays["WPCA.0.weight"] = rng.standard_normal((whitened, flat, 1, 1))
        arrays["WPCA.0.bias"] = rng.standard_normal(whitened) * 0.1
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def matlab_struct(
    arrays: Mapping[str, NDArray[Any]], mean: tuple[float, float, float]
) -> dict[str, Any]:
    """The same network as MatConvNet's structure, for ``scipy.io.savemat``.

    Height, width, in, out; centres with the opposite sign; the whitening's columns, as they
    stand, then mean the order c·K + k.
    """
    layers = np.empty((1, 35), dtype=object)
    for number in range(35):
        layers[0, number] = {"type": "other", "weights": np.empty((0, 0))}

    def weights(*items: NDArray[Any]) -> dict[str, Any]:
        cell = np.empty((1, len(items)), dtype=object)
        for i, item in enumerate(items):
            cell[0, i] = item
        return {"type": "conv", "stride": 1.0, "weights": cell}

    for number in VGG16_NUMBERS:
        kernel = arrays[f"encoder.{number}.weight"].transpose(2, 3, 1, 0)
        layers[0, number] = weights(kernel, arrays[f"encoder.{number}.bias"])
    assignment = arrays["pool.conv.weight"][:, :, 0, 0].T
    layers[0, 30] = weights(assignment, -arrays["pool.centroids"].T)
    if "WPCA.0.weight" in arrays:
        matrix = arrays["WPCA.0.weight"][:, :, 0, 0].T
        layers[0, 33] = weights(matrix[np.newaxis, np.newaxis], arrays["WPCA.0.bias"])
    colour = np.tile(np.array(mean, np.float32), (7, 7, 1))
    return {"net": {"layers": layers, "meta": {"normalization": {"averageImage": colour}}}}


def save_torch(path: Path, arrays: Mapping[str, NDArray[Any]], prefix: str = "") -> Path:
    """A checkpoint of a training: the state dictionary among other things."""
    import torch

    state = {prefix + name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}
    checkpoint = {
        "epoch": 30,
        "state_dict": state,
        "recalls": {1: np.float64(0.8), 5: 0.9},
        "best_score": np.float64(0.85),
        "optimizer": {"state": {}, "param_groups": [{"lr": 1e-4}]},
        "parallel": True,
    }
    torch.save(checkpoint, path)
    return path


def save_matlab(
    path: Path, arrays: Mapping[str, NDArray[Any]], mean: Any = (120, 110, 100)
) -> Path:
    from scipy.io import savemat

    savemat(path, matlab_struct(arrays, mean), do_compression=False)
    return path


def onnx_bytes(
    arrays: Mapping[str, NDArray[Any]], ceil: bool = True, names: str = "onnx::Conv_{}"
) -> bytes:
    """CALC exported to ONNX under an exporter's names for the weights."""
    import onnx
    from onnx import helper, numpy_helper

    nodes, initializers, top = [], [], "image"
    for number, (name, options) in enumerate(
        {
            "conv1": {"kernel_shape": [5, 5], "strides": [2, 2], "pads": [4] * 4},
            "conv2": {"kernel_shape": [4, 4], "pads": [2] * 4},
            "conv3": {"kernel_shape": [3, 3]},
        }.items()
    ):
        inputs = [names.format(2 * number), names.format(2 * number + 1)]
        for part, given in zip(("weight", "bias"), inputs, strict=True):
            initializers.append(numpy_helper.from_array(arrays[f"{name}.{part}"], given))
        nodes.append(helper.make_node("Conv", [top, *inputs], [f"c{number}"], **options))
        nodes.append(helper.make_node("Relu", [f"c{number}"], [f"r{number}"]))
        top = f"r{number}"
        if number < 2:
            pooling = {"kernel_shape": [3, 3], "strides": [2, 2], "ceil_mode": int(ceil)}
            nodes.append(helper.make_node("MaxPool", [top], [f"p{number}"], **pooling))
            nodes.append(helper.make_node("LRN", [f"p{number}"], [f"n{number}"], size=5))
            top = f"n{number}"
    image_in = helper.make_tensor_value_info("image", onnx.TensorProto.FLOAT, [1, 1, 120, 160])
    out = helper.make_tensor_value_info(top, onnx.TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "calc", [image_in], [out], initializers)
    return helper.make_model(graph).SerializeToString()


def npy_header(descr: str, shape: tuple[int, ...]) -> bytes:
    """The head of a .npy file, to be followed by anything."""
    text = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (64 - (10 + len(text) + 1) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text
