"""Readers of weights files, one per kind: bytes to arrays and texts. None executes anything."""

import io
import json
import pickle
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.caffemodel import read_caffemodel
from amusic_gym.techniques.matfile import TooLargeError, read_matfile

Arrays: TypeAlias = dict[str, NDArray[Any]]
MOST_BYTES = 2 << 30  # of a file, and of its contents; NetVLAD's public files have 0.6 GB
FLOOR_POOLING = "floor_pooling"  # metadata of a network (ONNX) whose pooling rounds sizes down


class RefusalError(ValueError):
    """Why a file that can be read is not; continues the sentence that starts with its path."""


def refuse_bombs(data: bytes) -> None:
    """Refuse a zip that unpacks to more than memory should hold."""
    if not data.startswith(b"PK"):
        return
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > MOST_BYTES:
        raise RefusalError(
            f"unpacks to {size} bytes, weights files here to {MOST_BYTES} at most; "
            "save the weights alone"
        )


def _read_safetensors(data: bytes) -> tuple[Arrays, dict[str, str]]:
    from safetensors.numpy import load

    arrays = load(data)
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    return arrays, header.get("__metadata__", {})


def _read_npz(data: bytes) -> tuple[Arrays, dict[str, str]]:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in file.files}, {}
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise RefusalError(
            "holds pickled Python objects, which can run code when read; "
            "save plain arrays of numbers"
        ) from None


def _read_torch(data: bytes) -> tuple[Arrays, dict[str, str]]:
    import torch

    # Checkpoints often hold a recall or a loss as a NumPy number, which is no code either.
    scalar = np.float64(0).__reduce__()[0]
    harmless: list[Any] = [np.dtype, *(type(np.dtype(kind)) for kind in ("f8", "f4", "i8"))]
    harmless += [(scalar, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")]
    try:
        with warnings.catch_warnings(), torch.serialization.safe_globals(harmless):
            warnings.simplefilter("ignore")  # files of old versions
            content = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        found = re.search(r"GLOBAL (\S+)", str(error))
        if found is None:  # PyTorch's text is for those who wrote the call
            raise ValueError("its contents are no tensors that PyTorch can read") from None
        raise RefusalError(
            f"holds a pickled object ({found[1]}) besides tensors, which can run code when read; "
            "save the state_dict alone, or convert the file to .safetensors"
        ) from None
    arrays: Arrays = {}
    left = MOST_BYTES
    for name, value in leaves(content):
        if not isinstance(value, torch.Tensor) or not value.is_floating_point():
            continue
        left -= 4 * value.numel()
        if left < 0:  # one number repeated in memory may claim any size
            raise RefusalError(f"claims {value.numel()} numbers for {name}; save the weights alone")
        arrays[name] = value.detach().to_dense().float().numpy()
    return arrays, {}


def _read_onnx(data: bytes) -> tuple[Arrays, dict[str, str]]:
    try:
        import onnx
    except ImportError:
        raise RefusalError(
            'needs the package onnx; install it: pip install "amusic-gym[onnx]"'
        ) from None
    from onnx import numpy_helper

    graph = onnx.load_model_from_string(data).graph
    if any(tensor.data_location == onnx.TensorProto.EXTERNAL for tensor in graph.initializer):
        raise RefusalError("keeps its weights in other files; export it as one file")
    arrays = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    convolutions = [node for node in graph.node if node.op_type == "Conv"]
    for number, node in enumerate(convolutions, start=1):
        for part, name in zip(("weight", "bias"), node.input[1:], strict=False):
            if name in arrays and not name.endswith(part):  # an exporter's name, say a number
                arrays[f"conv{number}.{part}"] = arrays.pop(name)
    pools = [node for node in graph.node if node.op_type == "MaxPool"]
    ceils = [any(a.name == "ceil_mode" and a.i for a in node.attribute) for node in pools]
    return arrays, {FLOOR_POOLING: "yes"} if pools and not any(ceils) else {}


def _read_matlab(data: bytes) -> tuple[Arrays, dict[str, str]]:
    if data.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise RefusalError("is a MATLAB 7.3 file; save it with -v7")
    try:
        found = leaves(read_matfile(data, MOST_BYTES))
    except TooLargeError:
        raise RefusalError(
            f"unpacks to more than {MOST_BYTES} bytes; save the weights alone"
        ) from None
    return {name: value for name, value in found if isinstance(value, np.ndarray)}, {}


def leaves(value: Any, name: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Arrays and other values of nested dictionaries and lists; names are joined by dots."""
    items: Iterator[tuple[Any, Any]]
    if depth > 20:
        raise RefusalError("is nested too deeply; save the weights alone")
    if isinstance(value, Mapping):
        items = iter(value.items())
    elif isinstance(value, list | tuple):
        items = enumerate(value)
    else:
        yield name, value
        return
    for key, item in items:
        yield from leaves(item, f"{name}.{key}" if name else str(key), depth + 1)


READERS: dict[str, Callable[[bytes], tuple[Arrays, dict[str, str]]]] = {
    ".safetensors": _read_safetensors,
    ".npz": _read_npz,
    ".pt": _read_torch,
    ".pth": _read_torch,
    ".ckpt": _read_torch,  # PyTorch Lightning's
    ".tar": _read_torch,  # name.pth.tar is PyTorch's, not tar's
    ".caffemodel": lambda data: (read_caffemodel(data), {}),
    ".onnx": _read_onnx,
    ".mat": _read_matlab,
}
"""Ending of the name -> reader of the bytes. To add a kind, add a line."""
