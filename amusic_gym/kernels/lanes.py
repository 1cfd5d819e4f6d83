"""Eight float32 numbers as one value in compiled code: what a processor's vector register holds.

Numba leaves vectors to LLVM's judgement of loops. That keeps no block of sums in registers, so
CoHOG's products of cells took at least twice as long. With these functions a loop says what it
means; LLVM still chooses the instructions, and splits values where registers are shorter.

They work in compiled code only. Arrays are float32 in C order, positions count numbers, and
nothing is checked.

Private parts of Numba: `cgutils.get_or_insert_function`, to call a function of LLVM's, and
`context.make_array`, for an array's address. tests/test_lanes.py fails where they change.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, NewType

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.datamodel.manager import DataModelManager
from numba.extending import intrinsic, models, register_model

from amusic_gym.kernels.codegen import Builder, Context, Signature, Typing, Values

LANES = 8
"""Numbers per value."""

Lanes = NewType("Lanes", object)
"""Such a value, in annotations of compiled functions."""

_FLOATS: Any = ir.VectorType(ir.FloatType(), LANES)
_INDEX: Any = ir.IntType(32)
_UNDEFINED: Any = ir.Constant(_FLOATS, ir.Undefined)
_intrinsic: Any = intrinsic  # typed, its functions would want Numba's typing context
_insert_function: Any = cgutils.get_or_insert_function


class _Lanes(types.Type):
    """Numba's name of the type; it is a plain value, like a number."""

    def __init__(self) -> None:
        super().__init__(name=f"float32x{LANES}")


_lanes = _Lanes()


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    """The type in memory: LLVM's vector."""

    def __init__(self, manager: DataModelManager, kind: types.Type) -> None:
        super().__init__(manager, kind, _FLOATS)


def _of_lanes(build: Callable[..., Any]) -> Any:
    """A function of lanes that gives lanes; ``build(builder, *values)`` emits its code."""

    def typed(typing_context: Typing, *values: types.Type) -> Any:
        def codegen(
            context: Context, builder: Builder, signature: Signature, arguments: Values
        ) -> Any:
            return build(builder, *arguments)

        return _lanes(*values), codegen

    vars(typed)["__signature__"] = inspect.signature(build)  # Numba asks how many values
    return _intrinsic(typed)


def _at(
    context: Context, builder: Builder, kind: types.Type, array: ir.Value, position: ir.Value
) -> Any:
    """Address of a number in an array."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.gep(data, [position], inbounds=True)


def _as_floats(builder: Builder, pointer: ir.Value) -> Any:
    return builder.bitcast(pointer, _FLOATS.as_pointer())


def _shuffled(builder: Builder, value: ir.Value, order: list[int]) -> Any:
    indices = ir.Constant(ir.VectorType(_INDEX, LANES), order)
    return builder.shuffle_vector(value, _UNDEFINED, indices)


def _call(builder: Builder, name: str, arguments: Sequence[ir.Value], **options: object) -> Any:
    """Call a function of LLVM's that takes values of eight lanes and gives one."""
    kind = ir.FunctionType(_FLOATS, [_FLOATS] * len(arguments))
    function = _insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32")
    return builder.call(function, arguments, **options)


def _maximum(builder: Builder, left: ir.Value, right: ir.Value) -> Any:
    # Without NaN it is one instruction. A comparison and a choice would be one too, but next to a
    # store LLVM makes a masked store of them, which some processors run very slowly.
    return _call(builder, "maxnum", (left, right), fastmath=("nnan", "nsz"))


@_intrinsic  # type: ignore[untyped-decorator]
def load(typing_context: Typing, array: types.Type, position: types.Type) -> Any:
    """``load(array, position)``: the numbers from ``position`` on."""

    def codegen(context: Context, builder: Builder, signature: Signature, arguments: Values) -> Any:
        pointer = _at(context, builder, signature.args[0], *arguments)
        return builder.load(_as_floats(builder, pointer), align=4)

    return _lanes(array, types.intp), codegen


@_intrinsic  # type: ignore[untyped-decorator]
def store(
    typing_context: Typing, array: types.Type, position: types.Type, value: types.Type
) -> Any:
    """``store(array, position, value)``: put them there."""

    def codegen(context: Context, builder: Builder, signature: Signature, arguments: Values) -> Any:
        pointer = _at(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], _as_floats(builder, pointer), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, _lanes), codegen


@_intrinsic  # type: ignore[untyped-decorator]
def spread(typing_context: Typing, array: types.Type, position: types.Type) -> Any:
    """``spread(array, position)``: the number at ``position``, in all lanes."""

    def codegen(context: Context, builder: Builder, signature: Signature, arguments: Values) -> Any:
        number = builder.load(_at(context, builder, signature.args[0], *arguments))
        first = builder.insert_element(_UNDEFINED, number, ir.Constant(_INDEX, 0))
        return _shuffled(builder, first, [0] * LANES)

    return _lanes(array, types.intp), codegen


@_intrinsic  # type: ignore[untyped-decorator]
def largest(typing_context: Typing, value: types.Type) -> Any:
    """``largest(value)``: the largest of the lanes, a float32; no NaN."""

    def codegen(context: Context, builder: Builder, signature: Signature, arguments: Values) -> Any:
        (found,) = arguments
        distance = LANES // 2
        while distance:
            turned = [(lane + distance) % LANES for lane in range(LANES)]
            found = _maximum(builder, found, _shuffled(builder, found, turned))
            distance //= 2
        return builder.extract_element(found, ir.Constant(_INDEX, 0))

    return types.float32(_lanes), codegen


zeros: Any = _of_lanes(lambda builder: ir.Constant(_FLOATS, [0.0] * LANES))
"""``zeros()``."""

add: Any = _of_lanes(lambda builder, left, right: builder.fadd(left, right))
"""``add(left, right)``: left + right."""

multiply: Any = _of_lanes(lambda builder, left, right: builder.fmul(left, right))
"""``multiply(left, right)``: left · right, lane by lane."""

multiply_add: Any = _of_lanes(
    lambda builder, left, right, addend: _call(builder, "fmuladd", (left, right, addend))
)
"""``multiply_add(left, right, addend)``: left · right + addend; one rounding where possible."""

greater: Any = _of_lanes(_maximum)
"""``greater(left, right)``: the greater one, lane by lane; no NaN."""
