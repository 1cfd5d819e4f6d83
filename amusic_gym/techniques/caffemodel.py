"""Arrays of a ``.caffemodel``: the protocol buffer of a Caffe network, without Caffe.

Only the fields that hold weights are read (``caffe.proto``: NetParameter, LayerParameter and its
older form, BlobProto); all else is skipped.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Numbers of the fields: of NetParameter, of a layer (new and old form), of BlobProto, of BlobShape.
LAYER, OLD_LAYER = 100, 2
NAME, BLOBS = {LAYER: 1, OLD_LAYER: 4}, {LAYER: 7, OLD_LAYER: 6}
OLD_SIZES, DATA, SHAPE, DOUBLE_DATA = (1, 2, 3, 4), 5, 7, 8
DIMENSIONS = 1

VARINT, EIGHT_BYTES, LENGTH, FOUR_BYTES = 0, 1, 2, 5
PARTS = ("weight", "bias")

Value = int | memoryview


def read_caffemodel(data: bytes) -> dict[str, NDArray[Any]]:
    """Weights and biases as ``layer.weight`` and ``layer.bias``.

    Raises:
        ValueError: when the bytes are no such protocol buffer.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for number, value in _fields(memoryview(data)):
        if number in NAME and isinstance(value, memoryview):
            name, blobs = _layer(value, NAME[number], BLOBS[number])
            arrays |= {f"{name}.{part}": blob for part, blob in zip(PARTS, blobs, strict=False)}
    return arrays


def _layer(data: memoryview, name_field: int, blobs_field: int) -> tuple[str, list[NDArray[Any]]]:
    name, blobs = "", []
    for number, value in _fields(data):
        if number == name_field and isinstance(value, memoryview):
            name = bytes(value).decode()
        elif number == blobs_field and isinstance(value, memoryview):
            blobs.append(_blob(value))
    return name, blobs


def _blob(data: memoryview) -> NDArray[Any]:
    values: list[NDArray[Any]] = [np.empty(0, "<f4")]
    old_sizes = [1, 1, 1, 1]
    shape: list[int] = []
    for number, value in _fields(data):
        if number in (DATA, DOUBLE_DATA) and isinstance(value, memoryview):
            values.append(np.frombuffer(value, "<f4" if number == DATA else "<f8"))
        elif number in OLD_SIZES and isinstance(value, int):
            old_sizes[OLD_SIZES.index(number)] = value
        elif number == SHAPE and isinstance(value, memoryview):
            shape = list(_dimensions(value))
    return np.concatenate(values).reshape(shape or old_sizes)


def _dimensions(shape: memoryview) -> Iterator[int]:
    for number, value in _fields(shape):
        if number != DIMENSIONS:
            continue
        if isinstance(value, int):
            yield value
        else:  # packed
            at = 0
            while at < len(value):
                size, at = _varint(value, at)
                yield size


def _fields(data: memoryview) -> Iterator[tuple[int, Value]]:
    """Number and value of each field of a message; groups, long out of use, are refused."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = _varint(data, at)
            yield number, value
            continue
        if kind == LENGTH:
            size, at = _varint(data, at)
        elif kind in (FOUR_BYTES, EIGHT_BYTES):
            size = 4 if kind == FOUR_BYTES else 8
        else:
            raise ValueError(f"a field of kind {kind}")
        if number == 0 or at + size > len(data):
            raise ValueError("a field runs past the end" if number else "a field of number 0")
        yield number, data[at : at + size]
        at += size


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """A number of 7 bits per byte, and where the next field begins."""
    value = 0
    for shift in range(0, 64, 7):
        if at >= len(data):
            raise ValueError("a number runs past the end")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number of more than 64 bits")
