"""Records and tables in memory that compiled functions read by name; each field is listed once.

A named tuple of twenty arrays is some two hundred arguments to a compiled function and to every
one that it calls; taking them apart costs time at every call from Python, and passing them on most
of the time that Numba compiles. A table is one address.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Self, get_type_hints

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core.typing import templates
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
)
from numba.np import numpy_support
from numpy.typing import NDArray

from amusic_gym.kernels.codegen import Builder, Context, Signature, Typing, Values

_cgutils: Any = importlib.import_module("numba.core.cgutils")  # these have no types
_arrays: Any = importlib.import_module("numba.np.arrayobj")

WORD = 8
"""Bytes of an entry; a number takes one, an array 1 + 2·ndim: address, shape, strides."""

ROUTES = "routes"
"""Name of the size that counts the routes of a batch."""

PER_FRAME = ("frames", "counts", "prefix", "replayed")
"""Names of sizes, of last dimensions only, that count the frames of a route."""


class Record:
    """Fields of one entry of a structured array: ``int``, ``float`` or ``bool``, or (dtype, size).

    A subclass lists the fields once, as annotations; ``dtype`` is made from them. Kernels get
    entries of such arrays and are annotated with the subclass.
    """

    dtype: ClassVar[np.dtype[np.void]]

    def __init_subclass__(cls) -> None:
        kinds: dict[Any, Any] = {int: np.int64, float: np.float64, bool: np.bool_}
        fields: list[Any] = []
        for name, kind in get_type_hints(cls, include_extras=True).items():
            if name != "dtype":
                several = getattr(kind, "__metadata__", None)  # of Annotated[..., dtype, size]
                fields.append((name, *several) if several else (name, kinds[kind]))
        cls.dtype = np.dtype(fields, align=True)


@dataclass(frozen=True)
class Column:
    """An array of a table.

    Attributes:
        dtype: of its entries.
        sizes: names of its dimensions' sizes.
        kept: whether its content goes on when the table gets more room; else it is scratch.
    """

    dtype: np.dtype[Any]
    sizes: tuple[str, ...]
    kept: bool


def array(kind: Any, *sizes: str, kept: bool = True) -> Any:
    """An array of a :class:`Table`: see :class:`Column`; ``kind`` may be a :class:`Record`."""
    record = isinstance(kind, type) and issubclass(kind, Record)
    return Column(np.dtype(kind.dtype if record else kind), sizes, kept)


class Layout(types.Type):
    """Names and kinds of a table's entries; compiled functions see it as a type.

    Args:
        name: distinguishes it from other layouts in compiled code.
        kinds: Numba's type of each entry, or another layout for a table inside this one.
    """

    def __init__(self, name: str, kinds: Mapping[str, Any]) -> None:
        super().__init__(name=f"Layout({name})")
        self.kinds = dict(kinds)
        self.offsets: dict[str, int] = {}
        self.words = 0
        for field, kind in self.kinds.items():
            self.offsets[field] = self.words
            self.words += _words_of(kind)

    def write(self, values: Any) -> NDArray[np.int64]:
        """The words of a table: the numbers, and the addresses and shapes of the arrays."""
        words = np.zeros(self.words, np.int64)
        for field, kind in self.kinds.items():
            value, start = getattr(values, field), self.offsets[field]
            if isinstance(kind, Layout):
                words[start : start + kind.words] = kind.write(value)
            elif isinstance(kind, types.Array):
                assert value.flags.c_contiguous
                assert value.ndim == kind.ndim
                assert _entry_of(value.dtype) == kind.dtype
                gone = isinstance(values, Table) and values.is_per_frame(field) and values.gone
                first = value.ctypes.data - gone * value.itemsize
                entries = [first, *value.shape, *value.strides]
                words[start : start + len(entries)] = entries
            elif kind is types.float64:
                words[start : start + 1].view(np.float64)[0] = value
            else:
                words[start] = value
        return words


@cache
def _entry_of(dtype: np.dtype[Any]) -> types.Type:
    """Numba's type of an array's entries; it takes Numba most of the time to make a table."""
    kind: types.Type = numpy_support.from_dtype(dtype)
    return kind


def _words_of(kind: Any) -> int:
    if isinstance(kind, Layout):
        return kind.words
    return 1 + 2 * kind.ndim if isinstance(kind, types.Array) else 1


class Table:
    """Arrays and numbers that compiled functions read by name.

    A subclass lists the fields once: numbers as annotations ``int``, ``float`` or ``bool``, tables
    inside it by their class, arrays by :func:`array`. The layout that kernels see, allocation,
    growth and copying are derived from that.

    Args:
        sizes: name of a size → number; of every size that an array has.
        given: the numbers and inner tables, and arrays that are not to be allocated as zeros.

    Attributes:
        sizes: as given.
        gone: frames whose entries were let go. Kernels count frames from the first all the same:
            they get an address so far before the arrays, and must not ask for what is gone.
    """

    layout: ClassVar[Layout]
    columns: ClassVar[dict[str, Column]]

    def __init_subclass__(cls) -> None:
        numbers: dict[Any, Any] = {int: types.int64, float: types.float64, bool: types.boolean}
        kinds: dict[str, Any] = {}
        cls.columns = {}
        for name, kind in get_type_hints(cls).items():
            column = getattr(cls, name, None)
            if isinstance(column, Column):
                cls.columns[name] = column
                kinds[name] = types.Array(_entry_of(column.dtype), len(column.sizes), "C")
            elif name not in ("layout", "columns", "sizes"):
                kinds[name] = numbers[kind] if kind in numbers else kind.layout
        cls.layout = Layout(cls.__qualname__, kinds)

    def __init__(self, sizes: Mapping[str, int], **given: Any) -> None:
        self.sizes = dict(sizes)
        self.gone = 0
        for name, column in self.columns.items():
            if name not in given:
                setattr(self, name, np.zeros([sizes[size] for size in column.sizes], column.dtype))
        for name, value in given.items():
            setattr(self, name, value)

    def grown(self, sizes: Mapping[str, int], **given: Any) -> Self:
        """The same with more room; what is kept is copied into the corner of the new arrays."""
        twin = type(self)(sizes, **{**self._others(), **given})
        twin.gone = self.gone
        for name, column in self.columns.items():
            old = getattr(self, name)
            if column.kept:
                getattr(twin, name)[tuple(slice(0, size) for size in old.shape)] = old
        return twin

    def is_per_frame(self, name: str) -> bool:
        """Whether an array has an entry per frame."""
        return self.columns[name].sizes[-1] in PER_FRAME

    def let_go(self, frames: int) -> None:
        """Make room for as many frames as are let go, the oldest; the addresses change."""
        self.gone += frames
        for name in filter(self.is_per_frame, self.columns):
            array = getattr(self, name)
            array[..., :-frames] = array[..., frames:]
            array[..., -frames:] = 0

    def repeated(self, copies: int, **given: Any) -> Self:
        """The same for ``copies`` times as many routes: each stands so often in a row."""
        sizes = {**self.sizes, ROUTES: copies * self.sizes[ROUTES]}
        twin = type(self)(sizes, **{**self._others(), **given})
        for name, column in self.columns.items():
            values = getattr(self, name)
            if ROUTES in column.sizes:
                values = np.repeat(values, copies, column.sizes.index(ROUTES))
            getattr(twin, name)[...] = values
        return twin

    def _others(self) -> dict[str, Any]:
        """All fields but the arrays."""
        return {name: getattr(self, name) for name in self.layout.kinds if name not in self.columns}

    def write(self) -> NDArray[np.int64]:
        """The words that kernels read, by the address of their memory; they hold addresses only.

        To be written again when an array is replaced; whoever keeps them keeps the table, too.
        """
        return self.layout.write(self)


@register_model(Layout)
class _LayoutModel(models.OpaqueModel):
    """A pointer."""


@infer_getattr
class _LayoutAttribute(templates.AttributeTemplate):
    key = Layout

    def generic_resolve(self, layout: Layout, attribute: str) -> Any:  # type: ignore[override]
        return layout.kinds.get(attribute)


def _read(context: Context, builder: Builder, layout: Layout, table: ir.Value, field: str) -> Any:
    kind, word = layout.kinds[field], _cgutils.intp_t
    place = _cgutils.pointer_add(builder, table, layout.offsets[field] * WORD)
    if isinstance(kind, Layout):
        return place
    if not isinstance(kind, types.Array):
        value_type = context.get_value_type(kind)
        if kind is not types.boolean:
            return builder.load(builder.bitcast(place, value_type.as_pointer()))
        number = builder.load(builder.bitcast(place, word.as_pointer()))
        return builder.icmp_signed("!=", number, number.type(0))
    entries = builder.bitcast(place, word.as_pointer())

    def entry(number: int) -> Any:
        return builder.load(_cgutils.gep_inbounds(builder, entries, number))

    return array_at(
        context,
        builder,
        kind,
        entry(0),
        [entry(1 + axis) for axis in range(kind.ndim)],
        [entry(1 + kind.ndim + axis) for axis in range(kind.ndim)],
    )


_lower: Any = lower_getattr_generic
_lower(Layout)(_read)


def array_at(
    context: Context,
    builder: Builder,
    kind: types.Array,
    address: ir.Value,
    shape: Values,
    strides: Values,
) -> Any:
    """Numba's array over memory that others own."""
    array = _arrays.make_array(kind)(context, builder)
    item = context.get_data_type(kind.dtype)
    _arrays.populate_array(
        array,
        data=builder.inttoptr(address, item.as_pointer()),
        shape=shape,
        strides=strides,
        itemsize=context.get_constant(types.intp, context.get_abi_sizeof(item)),
        meminfo=None,
    )
    return array._getvalue()


def _view(typing_context: Typing, address: types.Type, size: types.Type, dtype: types.DType) -> Any:
    """Array (size,) of a dtype over memory that others own. The first parameter is Numba's.

    Routes of one batch lie in different banks of different size; a table of addresses lets one
    compiled loop visit all of them. Whoever stores an address also keeps its array alive.
    """
    kind = types.Array(dtype.dtype, 1, "C")

    def codegen(context: Context, builder: Builder, signature: Signature, arguments: Values) -> Any:
        item = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        strides = [context.get_constant(types.intp, item)]
        return array_at(context, builder, kind, arguments[0], [arguments[1]], strides)

    return kind(types.int64, types.int64, dtype), codegen


view: Any = intrinsic(_view)


def _part(typing_context: Typing, values: types.Array, start: types.Type, size: types.Type) -> Any:
    """Array (size,) that begins at an index of a longer one. The first parameter is Numba's.

    What a slice is, unchecked: it compiles sooner, and a loop over it from 0 runs in SIMD. One from
    another index does not, because an index might be negative.
    """

    def codegen(context: Context, builder: Builder, signature: Signature, arguments: Values) -> Any:
        array = context.make_array(values)(context, builder, arguments[0])
        place = builder.gep(array.data, [arguments[1]])
        address = builder.ptrtoint(place, _cgutils.intp_t)
        strides = _cgutils.unpack_tuple(builder, array.strides)
        return array_at(context, builder, values, address, [arguments[2]], strides)

    return values(values, types.int64, types.int64), codegen


part: Any = intrinsic(_part)


def reader(table: type[Table]) -> Any:
    """Compiled function that takes the address of a table's words and gives the table."""
    layout = table.layout

    def at(typing_context: Typing, address: types.Type) -> Any:
        def codegen(
            context: Context, builder: Builder, signature: Signature, arguments: Values
        ) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(layout))

        return layout(types.int64), codegen

    return intrinsic(at)
