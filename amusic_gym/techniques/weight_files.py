"""Weights files of any kind as arrays: read once, checked, and nothing in them is ever executed.

The kind is known by the name's ending. What the arrays mean is the techniques' affair.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.weight_readers import (
    MOST_BYTES,
    READERS,
    Arrays,
    RefusalError,
    refuse_bombs,
)
from amusic_gym.utils.names import few
from amusic_gym.utils.reading import open_file
from amusic_gym.utils.storage import write_whole

FORMAT_VERSION = 1  # of our own layout; rises when stored weights would mean something else
DESCRIPTION = "amusic_gym"  # name of the metadata in which a file in our layout describes itself
PRETRAINED = Path(__file__).parent / "pretrained"


@dataclass(frozen=True)
class WeightFile:
    """What a weights file holds."""

    path: Path  # where it was read from
    digest: str  # SHA-256 of its bytes, 64 hexadecimal digits
    arrays: Arrays  # name -> array of floating point numbers, in the shape the file gives it
    metadata: Mapping[str, str]  # texts that the file holds besides

    def description(self, technique: str) -> dict[str, Any] | None:
        """What a file in our layout says of itself; None for a file of another origin.

        Raises:
            ValueError: for weights of another technique, of a newer version, or a damaged text.
        """
        text = self.metadata.get(DESCRIPTION)
        if text is None:
            return None
        try:
            found: dict[str, Any] = dict(json.loads(text))
            version, holds = int(found["format_version"]), found["technique"]
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise ValueError(
                f"the metadata of {self.path} is damaged ({error!r}); copy the file again"
            ) from None
        if holds != technique:
            raise ValueError(
                f"{self.path} holds weights of {holds}, its first layer is "
                f"{next(iter(self.arrays), 'missing')}; give weights of {technique}"
            )
        if version > FORMAT_VERSION:
            raise ValueError(
                f"{self.path} has format version {version}, this amusic-gym reads up to "
                f"{FORMAT_VERSION}; install a newer one"
            )
        return found

    def under(self, anchor: str) -> WeightFile | None:
        """The part of the file below the prefix in front of ``anchor``, the prefix taken off.

        ``module`` (PyTorch's parallel training) is no part of a name; ``/weight`` and ``_weight``
        count as ``.weight``. None: no such array.

        Raises:
            ValueError: when several prefixes hold an array of this name.
        """
        plain = {_plain(name): array for name, array in self.arrays.items()}
        pattern = re.compile(rf"(?:.*\.)?(?={re.escape(anchor)}$)")
        prefixes = [found.group() for found in map(pattern.match, plain) if found]
        if not prefixes:
            return None
        if len(prefixes) > 1:
            raise ValueError(
                f"{self.path} holds several networks, {', '.join(p + anchor for p in prefixes)}; "
                "save one of them alone"
            )
        cut = len(prefixes[0])
        arrays = {name[cut:]: plain[name] for name in plain if name.startswith(prefixes[0])}
        return WeightFile(self.path, self.digest, arrays, self.metadata)

    def part(self, technique: str, anchor: str) -> WeightFile:
        """As :meth:`under`, refused where there is no such array."""
        found = self.under(anchor)
        if found is None:
            raise self.missing(technique, anchor)
        return found

    def missing(self, technique: str, name: str) -> ValueError:
        """The refusal of a file without a layer."""
        return ValueError(
            f"{self.path} has no layer {name}, which {technique} needs; it holds "
            f"{few(list(self.arrays), 4) or 'no weights'}: give weights of {technique}"
        )

    def layer(self, technique: str, name: str, *shape: int | None) -> NDArray[np.float32]:
        """One layer's array as float32, of the given shape; None in it: as the file has it.

        ``technique`` is whose layer it is, for the refusal.

        Raises:
            ValueError: naming the layer that is missing, of another shape, or not finite.
        """
        if name not in self.arrays:
            raise self.missing(technique, name)
        array = self.arrays[name]
        if len(shape) == 1 and array.size in array.shape:
            array = array.ravel()  # MATLAB and old Caffe files give a vector 2 or 4 dimensions
        fits = all(want in (None, have) for want, have in zip(shape, array.shape, strict=False))
        if len(shape) != array.ndim or not fits or 0 in array.shape:
            wanted = ", ".join("any" if size is None else str(size) for size in shape)
            raise ValueError(
                f"layer {name} of {self.path} has shape {array.shape}; {technique} needs "
                f"({wanted}): give weights of {technique}"
            )
        with np.errstate(over="ignore"):  # what does not fit float32 is refused below
            values = np.require(array, np.float32, ["C", "W"])
        if not np.isfinite(values).all():
            raise ValueError(
                f"layer {name} of {self.path} holds NaN or infinite numbers; "
                "download or train the weights again"
            )
        return values


def _plain(name: str) -> str:
    pieces = re.sub(r"[_/](weight|bias)$", r".\1", name).split(".")
    return ".".join(piece for piece in pieces if piece != "module")


def write_weights(
    path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]], description: dict[str, Any]
) -> Path:
    """Write weights in our layout, whole or not at all, to a name in ``.safetensors``."""
    from safetensors.numpy import save

    path = Path(path)
    if path.suffix != ".safetensors":
        raise ValueError(f"{path} should end in .safetensors; rename it")
    text = json.dumps({"format_version": FORMAT_VERSION, **description}, sort_keys=True)
    return write_whole(path, save(dict(arrays), {DESCRIPTION: text}))


def shipped(name: str) -> Path:
    """The weights of a technique that ship with the package.

    Raises:
        FileNotFoundError: when the installation lacks them.
    """
    path = PRETRAINED / f"{name}.safetensors"
    if not path.is_file():
        raise FileNotFoundError(
            f"the weights that ship, {path}, are missing; install amusic-gym again, or give a "
            f"weights file: --weights {name}=FILE, or weights=FILE in Python"
        )
    return path


def read_weights(path: str | os.PathLike[str]) -> WeightFile:
    """Read a weights file: safetensors, NumPy, PyTorch, Caffe, ONNX or MATLAB.

    Nothing in the file is executed: PyTorch files are read as tensors only, pickled objects are
    refused.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, damaged, too large, of an unknown kind, or holds objects
            instead of numbers; when ONNX is needed and not installed.
    """
    path = Path(path)
    with open_file(path) as file:
        read = READERS.get(path.suffix.lower())
        if read is None:
            raise ValueError(
                f"{path} is no weights file by its name; known endings: {', '.join(READERS)}"
            )
        size = os.fstat(file.fileno()).st_size
        if size == 0:
            raise ValueError(f"{path} is empty; copy or download it again")
        if size > MOST_BYTES:
            raise ValueError(
                f"{path} has {size} bytes, weights files here have {MOST_BYTES} at most; "
                "save the weights alone"
            )
        data = file.read()
    try:
        refuse_bombs(data)
        arrays, metadata = read(data)
    except RefusalError as refusal:
        raise ValueError(f"{path} {refusal}") from None
    except Exception as error:  # damaged files raise nearly anything, MemoryError included
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise ValueError(
            f"{path} is no whole {path.suffix} file ({reason}); copy or download it again"
        ) from None
    floats = {name: array for name, array in arrays.items() if array.dtype.kind == "f"}
    return WeightFile(path, hashlib.sha256(data).hexdigest(), floats, metadata)
