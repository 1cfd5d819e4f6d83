"""Tables in memory that compiled functions read by name: many arrays behind one address.

A named tuple of twenty arrays is some two hundred arguments to a compiled function and to every
one that it calls; taking them apart costs time at every call from Python, and passing them on most
of the time that Numba compiles. A table is one address.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
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

_cgutils: Any = importlib.import_module("numba.core.cgutils")  # these have no types
_arrays: Any = importlib.import_module("numba.np.arrayobj")

WORD = 8
"""Bytes of an entry; a number takes one, an array 1 + 2·ndim: address, shape, strides."""

NUMBERS: dict[type, types.Type] = {int: types.int64, float: types.float64, bool: types.boolean}

Field = Any  # int, float, bool, (dtype, dimensions) of an array, or another Layout


class Layout(types.Type):
    """Names and kinds of a table's entries; compiled functions see it as a type.

    Args:
        name: distinguishes it from other layouts in compiled code.
        fields: ``int``, ``float`` or ``bool`` for a number, ``(dtype, dimensions)`` for an array,
            a layout for a table inside this one.
    """

    def __init__(self, name: str, fields: Mapping[str, Field]) -> None:
        super().__init__(name=f"Layout({name})")
        self.kinds: dict[str, types.Type] = {}
        self.offsets: dict[str, int] = {}
        self.words = 0
        for field, given in fields.items():
            kind: Any = NUMBERS.get(given, given) if isinstance(given, type) else given
            if isinstance(given, tuple):
                dtype, dimensions = given
                kind = types.Array(numpy_support.from_dtype(np.dtype(dtype)), dimensions, "C")
            self.kinds[field], self.offsets[field] = kind, self.words
            self.words += _words_of(kind)

    def write(self, values: Any) -> NDArray[np.int64]:
        """A table of the values: attributes of the layout's names.

        The table knows addresses only: whoever keeps it keeps ``values``, too.
        """
        table = np.zeros(self.words, np.int64)
        for field, kind in self.kinds.items():
            value, start = getattr(values, field), self.offsets[field]
            if isinstance(kind, Layout):
                table[start : start + kind.words] = kind.write(value)
            elif isinstance(kind, types.Array):
                assert value.flags.c_contiguous
                assert value.ndim == kind.ndim
                assert numpy_support.from_dtype(value.dtype) == kind.dtype
                entries = [value.ctypes.data, *value.shape, *value.strides]
                table[start : start + len(entries)] = entries
            elif kind is types.float64:
                table[start : start + 1].view(np.float64)[0] = value
            else:
                table[start] = value
        return table


def _words_of(kind: types.Type) -> int:
    if isinstance(kind, Layout):
        return kind.words
    return 1 + 2 * kind.ndim if isinstance(kind, types.Array) else 1


@register_model(Layout)
class _LayoutModel(models.OpaqueModel):
    """A pointer."""


@infer_getattr
class _LayoutAttribute(templates.AttributeTemplate):
    key = Layout

    def generic_resolve(self, layout: Layout, attribute: str) -> Any:  # type: ignore[override]
        return layout.kinds.get(attribute)


def _read(context: Any, builder: Any, layout: Layout, table: Any, field: str) -> Any:
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
    context: Any, builder: Any, kind: Any, address: Any, shape: list[Any], strides: list[Any]
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


def _view(typing_context: Any, address: Any, size: Any, dtype: Any) -> Any:
    """Array (size,) of a dtype over memory that others own. The first parameter is Numba's.

    Routes of one batch lie in different banks of different size; a table of addresses lets one
    compiled loop visit all of them. Whoever stores an address also keeps its array alive.
    """
    kind = types.Array(dtype.dtype, 1, "C")

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        item = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        strides = [context.get_constant(types.intp, item)]
        return array_at(context, builder, kind, arguments[0], [arguments[1]], strides)

    return kind(types.int64, types.int64, dtype), codegen


view: Any = intrinsic(_view)


def _part(typing_context: Any, values: Any, start: Any, size: Any) -> Any:
    """Array (size,) that begins at an index of a longer one. The first parameter is Numba's.

    What a slice is, unchecked: it compiles sooner, and a loop over it from 0 runs in SIMD. One from
    another index does not, because an index might be negative.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(values)(context, builder, arguments[0])
        place = builder.gep(array.data, [arguments[1]])
        address = builder.ptrtoint(place, _cgutils.intp_t)
        strides = _cgutils.unpack_tuple(builder, array.strides)
        return array_at(context, builder, values, address, [arguments[2]], strides)

    return values(values, types.int64, types.int64), codegen


part: Any = intrinsic(_part)


def reader(layout: Layout) -> Any:
    """Compiled function that takes the address of a table and gives the table."""

    def at(typing_context: Any, address: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(layout))

        return layout(types.int64), codegen

    return intrinsic(at)
