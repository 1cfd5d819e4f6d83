"""The changing part of objects as plain data: numbers, texts, arrays; never a pickle."""

import io
import json
from collections import deque
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym.utils.reading import read_regular
from amusic_gym.utils.storage import write_whole

_KIND = "\0"  # entry of a mapping that stands for something else
_ARRAY, _OBJECT, _MAPPING, _GENERATOR = "array", "object", "mapping", "generator"
_TREE = "tree"  # name of the JSON text among the arrays
_MOST_BYTES = 2**33

Arrays = dict[str, Any]


def taken(value: Any, arrays: Arrays, skip: Collection[str] = (), where: str = "") -> Any:
    """What JSON can hold of ``value``, its arrays put into ``arrays`` by their place in it.

    Of an object, that is its attributes, but for those that do not change: functions, modules of
    PyTorch, frozen dataclasses.

    The arrays of ``value`` are numbered in ``arrays``; attributes named in ``skip`` are left out.

    Raises:
        TypeError: for anything else, naming it.
    """
    value = value.item() if isinstance(value, np.generic) else value
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        # Records as bytes: .npy forgets how they are aligned.
        plain = np.ascontiguousarray(value).view(np.uint8) if value.dtype.names else value
        arrays[str(len(arrays))] = plain.copy()
        return {_KIND: _ARRAY, "at": str(len(arrays) - 1), "dtype": str(value.dtype)}
    if isinstance(value, np.random.Generator):
        return {_KIND: _GENERATOR, "state": taken(value.bit_generator.state, arrays, (), where)}
    if isinstance(value, list | tuple | deque):
        return [taken(each, arrays, skip, f"{where}[{i}]") for i, each in enumerate(value)]
    if isinstance(value, Mapping):
        pairs = [[key, taken(each, arrays, skip, f"{where}.{key}")] for key, each in value.items()]
        return {_KIND: _MAPPING, "pairs": pairs}
    if not hasattr(value, "__dict__"):
        raise TypeError(
            f"{where} is a {type(value).__name__}, which cannot be saved; keep numbers, texts,"
            " arrays, lists and mappings of them"
        )
    parts = {
        name: taken(each, arrays, skip, f"{where}.{name}")
        for name, each in vars(value).items()
        if name not in skip and not _is_constant(each)
    }
    return {_KIND: _OBJECT, "parts": parts}


def put_back(old: Any, saved: Any, arrays: Arrays, where: str = "") -> Any:
    """The value that ``taken`` gave ``saved`` and ``arrays`` for.

    ``old`` is an equal value in another state; objects in it are changed in place.

    Raises:
        ValueError: where the two are not alike.
    """
    kind = saved.get(_KIND) if isinstance(saved, dict) else None
    if kind == _ARRAY:
        return _array(old, arrays[saved["at"]], saved["dtype"], where)
    if kind == _MAPPING:
        before = old if isinstance(old, Mapping) else {}
        return {
            key: put_back(before.get(key), each, arrays, f"{where}.{key}")
            for key, each in saved["pairs"]
        }
    if kind == _GENERATOR:
        old.bit_generator.state = put_back(None, saved["state"], arrays, where)
        return old
    if kind == _OBJECT:
        for name, each in saved["parts"].items():
            if not hasattr(old, name):
                raise ValueError(f"{where} has no {name}")
            setattr(old, name, put_back(getattr(old, name), each, arrays, f"{where}.{name}"))
        return old
    if isinstance(saved, list):
        there = list(old) if isinstance(old, list | tuple | deque) else []
        there += [None] * (len(saved) - len(there))
        made = [
            put_back(one, each, arrays, f"{where}[{i}]")
            for i, (one, each) in enumerate(zip(there, saved, strict=False))
        ]
        if isinstance(old, deque):
            return deque(made, old.maxlen)
        return tuple(made) if isinstance(old, tuple) else made
    return saved


def _array(old: Any, saved: Any, dtype: str, where: str) -> Any:
    if not isinstance(old, np.ndarray):
        return saved
    if (str(old.dtype), old.ndim) != (dtype, saved.ndim):
        raise ValueError(f"{where} is of another kind")
    return saved.view(old.dtype) if old.dtype.names else saved


def _is_constant(value: Any) -> bool:
    """Whether it is code or settings."""
    parameters = getattr(type(value), "__dataclass_params__", None)
    return callable(value) or (parameters is not None and parameters.frozen)


def write_state(path: str | Path, tree: Any, arrays: Arrays) -> Path:
    """Write what `taken` gave, whole or not at all; raises an OSError where it cannot."""
    file = io.BytesIO()
    text = np.frombuffer(json.dumps(tree).encode(), np.uint8)
    np.savez(file, allow_pickle=False, **{**arrays, _TREE: text})
    return write_whole(path, file.getvalue())


def read_state(path: str | Path) -> tuple[Any, Arrays]:
    """What `write_state` wrote.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged.
    """
    path = Path(path)
    content = read_regular(path, _MOST_BYTES)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        return json.loads(arrays.pop(_TREE).tobytes()), arrays
    except Exception as error:  # a damaged zip raises nearly anything
        raise ValueError(f"{path} is no saved state, or damaged ({error!r}); begin anew") from None
