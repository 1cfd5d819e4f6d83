"""Floating point arrays of a MATLAB file (level 5, as ``save -v6`` and ``-v7`` write it).

SciPy's reader trusts a file's sizes, and a damaged one can end the process. Here all is checked;
what holds no weights (texts, whole numbers, sparse matrices, objects) is skipped.
"""

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

HEADER = 128
INT8, INT32, UINT32, MATRIX, COMPRESSED = 1, 5, 6, 14, 15
NUMBERS = {
    **{1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4"},
    **{7: "f4", 9: "f8", 12: "i8", 13: "u8"},
}
"""Type of an element → how NumPy calls its numbers."""

CELL, STRUCT = 1, 2
FLOATS = {6: "f8", 7: "f4"}  # class of a matrix → numbers; whole ones may be stored in fewer bytes
COMPLEX = 0x800
DEEPEST = 20
PIECE = 1 << 20


class TooLargeError(ValueError):
    """The contents exceed what they may."""


def read_matfile(data: bytes, most: int) -> dict[str, Any]:
    """Variables by name: arrays of floats, dictionaries (structures) and lists (cells).

    A structure or a cell of one item is the item. What else there is, is None.

    Raises:
        ValueError: when the bytes are no such file; `TooLargeError` for contents of more than
            ``most`` bytes.
    """
    if data[126:HEADER] not in (b"IM", b"MI"):
        raise ValueError("no MATLAB file of level 5")
    reader = _Reader("<" if data[126:HEADER] == b"IM" else ">", most)
    found: dict[str, Any] = {}
    for kind, content in reader.elements(memoryview(data)[HEADER:]):
        if kind == COMPRESSED:
            ((kind, content),) = reader.elements(reader.inflated(content))
        if kind == MATRIX:
            name, value = reader.matrix(content)
            found[name] = value
    return found


@dataclass
class _Reader:
    """Reads elements: a type, a number of bytes, and the bytes.

    ``left`` is how many bytes arrays and unpacked elements may still have.
    """

    order: Literal["<", ">"]  # of bytes
    left: int

    def take(self, size: int) -> None:
        """Count bytes before they are allocated."""
        self.left -= size
        if self.left < 0:
            raise TooLargeError

    def inflated(self, content: memoryview) -> memoryview:
        """A compressed element, unpacked once to count its bytes and then to keep them."""
        counter, size, rest = zlib.decompressobj(), 0, bytes(content)
        while piece := len(counter.decompress(rest, PIECE)):
            self.take(piece)
            size, rest = size + piece, counter.unconsumed_tail
        return memoryview(zlib.decompress(content, bufsize=max(size, 1)))

    def numbers(self, kind: str, content: memoryview) -> Any:
        """Numbers of a type of NumPy's, in the file's order of bytes."""
        return np.frombuffer(content, np.dtype(kind).newbyteorder(self.order))

    def elements(self, data: memoryview) -> Iterator[tuple[int, memoryview]]:
        """Type and bytes of the elements that stand one after the other."""
        at = 0
        while at < len(data):
            first, size = self.numbers("u4", data[at : at + 8]).tolist()
            if first >> 16:  # a small one: type and size in four bytes, and up to four more
                first, size = first & 0xFFFF, first >> 16
                content = data[at + 4 : at + 8][:size]
                at += 8
            else:
                content = data[at + 8 : at + 8 + size]
                at += 8 + size + (0 if first == COMPRESSED else -size % 8)
            if len(content) != size:
                raise ValueError("an element is cut off")
            yield first, content

    def matrix(self, content: memoryview, depth: int = 0) -> tuple[str, Any]:
        """Name and value of an array, a cell or a structure."""
        if not content:  # an empty one within a cell or structure
            return "", None
        if depth > DEEPEST:
            raise ValueError("it is nested too deeply")
        parts = self.elements(content)
        flags = int(self.numbers("u4", self.next(parts, UINT32))[0])
        shape = tuple(self.numbers("i4", self.next(parts, INT32)).tolist())
        name = bytes(self.next(parts, INT8)).decode("latin-1")
        if len(shape) < 2 or min(shape) < 0:
            raise ValueError(f"an array has shape {shape}")
        kind = flags & 0xFF
        if kind == CELL:
            items = [self.item(part, depth) for part in parts]
            return name, _shaped(items, shape)
        if kind == STRUCT:
            return name, _shaped(self.structures(parts, depth), shape)
        if kind in FLOATS and not flags & COMPLEX:
            return name, self.array(FLOATS[kind], next(parts), shape)
        return name, None

    def structures(self, parts: Iterator[tuple[int, memoryview]], depth: int) -> list[Any]:
        """The structures of an array: their fields follow each other."""
        length = int(self.numbers("i4", self.next(parts, INT32))[0])
        text = bytes(self.next(parts, INT8))
        if length < 1 or len(text) % length:
            raise ValueError("the names of a structure's fields are cut off")
        starts = range(0, len(text), length)
        names = [text[at : at + length].partition(b"\0")[0].decode("latin-1") for at in starts]
        values = [self.item(part, depth) for part in parts]
        if not names:
            return []
        rows = [values[at : at + len(names)] for at in range(0, len(values), len(names))]
        return [dict(zip(names, row, strict=True)) for row in rows]

    def item(self, part: tuple[int, memoryview], depth: int) -> Any:
        """An item of a cell or a structure."""
        kind, content = part
        if kind != MATRIX:
            raise ValueError("an item is no array")
        return self.matrix(content, depth + 1)[1]

    def array(self, kind: str, part: tuple[int, memoryview], shape: tuple[int, ...]) -> Any:
        """An array of floats in its own shape."""
        stored, content = part
        values = self.numbers(NUMBERS[stored], content)
        if len(values) != math.prod(shape):
            raise ValueError(f"an array of shape {shape} has {len(values)} numbers")
        self.take(len(values) * np.dtype(kind).itemsize)
        return values.astype(kind, copy=False).reshape(shape, order="F")

    def next(self, parts: Iterator[tuple[int, memoryview]], wanted: int) -> memoryview:
        """The content of the next element, which is of a type."""
        kind, content = next(parts, (None, memoryview(b"")))
        if kind != wanted:
            raise ValueError("an array's head is damaged")
        return content


def _shaped(items: list[Any], shape: tuple[int, ...]) -> Any:
    """The items in NumPy's order of a cell's shape; a single one alone."""
    if len(items) != math.prod(shape):
        raise ValueError(f"a cell or structure of shape {shape} has {len(items)} items")
    if len(items) == 1:
        return items[0]
    order = np.arange(len(items)).reshape(shape, order="F").ravel()
    return [items[at] for at in order]
