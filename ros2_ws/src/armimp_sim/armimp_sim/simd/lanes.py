"""Several floating-point numbers as one value of compiled code: a SIMD register, or a few.

A compiler may or may not turn a loop over lanes into SIMD instructions, depending on the length of
the loop, on what surrounds it and on its version. With this type nothing is left to chance: it is
LLVM's own vector type, which becomes the widest registers that the processor has. The same
functions compile for a plain ``float`` too, operation by operation, so that a lane gives the same
bits alone and beside others.

Supported are ``+ - * /``, negation and ``abs`` between packed values and with floats, and the
functions below. To Python's type checker, a packed value is a ``float``.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable
from numpy import float64
from numpy.typing import NDArray

from armimp_common.compiled import compiled

Tag = tuple[float, ...]
"""Carries a number as a compile-time constant: the number of elements."""

_DOUBLE, _INTEGER = ir.DoubleType(), ir.IntType(64)
_OPERATIONS: dict[Callable[..., Any], str] = {
    operator.add: "fadd",
    operator.sub: "fsub",
    operator.mul: "fmul",
    operator.truediv: "fdiv",
    operator.iadd: "fadd",
    operator.isub: "fsub",
    operator.imul: "fmul",
    operator.itruediv: "fdiv",
}


class _Packed(types.Type):
    """Type of ``width`` floats in one value."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"Packed({width})")


def _of_width(width: int) -> Any:
    return _Packed(width) if width > 1 else types.float64


def _vector(kind: Any, element: Any = _DOUBLE) -> Any:
    """LLVM type of a packed value, or of a single one."""
    return ir.VectorType(element, kind.width) if isinstance(kind, _Packed) else element


def _constant(kind: Any, element: Any, value: int) -> Any:
    shape = _vector(kind, element)
    return ir.Constant(shape, [value] * kind.width if isinstance(kind, _Packed) else value)


class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _vector(kind))


register_model(_Packed)(_Model)


def _common(kinds: Sequence[Any]) -> Any:
    """The packed type among ``kinds``, if the others are that too or floats."""
    packed = {kind for kind in kinds if isinstance(kind, _Packed)}
    floats = all(isinstance(kind, _Packed | types.Float) for kind in kinds)
    return packed.pop() if floats and len(packed) == 1 else None


def _widened(context: Any, builder: Any, value: Any, kind: Any, target: Any) -> Any:
    """``value`` in every lane of ``target``."""
    if kind == target:
        return value
    single = context.cast(builder, value, kind, types.float64)
    if not isinstance(target, _Packed):
        return single
    empty = ir.Constant(_vector(target), ir.Undefined)
    first = builder.insert_element(empty, single, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, empty, _constant(target, ir.IntType(32), 0))


def _define_operation(function: Callable[..., Any], instruction: str) -> None:
    def typed(_context: Any) -> Callable[[Any, Any], Any]:
        return lambda a, b: _common((a, b))

    def lowered(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a, b = (
            _widened(context, builder, value, kind, signature.return_type)
            for value, kind in zip(args, signature.args, strict=True)
        )
        return getattr(builder, instruction)(a, b)

    type_callable(function)(typed)
    for pair in ((_Packed, _Packed), (_Packed, types.Float), (types.Float, _Packed)):
        lower_builtin(function, *pair)(lowered)


def _define_sign(function: Callable[..., Any], lowered: Callable[..., Any]) -> None:
    def typed(_context: Any) -> Callable[[Any], Any]:
        return lambda a: a if isinstance(a, _Packed) else None

    type_callable(function)(typed)
    lower_builtin(function, _Packed)(lowered)


def _negative(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    return builder.fneg(args[0])


def _absolute(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
    shape = args[0].type
    name = f"llvm.fabs.v{signature.return_type.width}f64"
    declared = ir.FunctionType(shape, [shape])
    return builder.call(cgutils.get_or_insert_function(builder.module, declared, name), args)


for _function, _instruction in _OPERATIONS.items():
    _define_operation(_function, _instruction)
_define_sign(operator.neg, _negative)
_define_sign(abs, _absolute)


def _address(context: Any, builder: Any, array: Any, index: Any, kind: Any) -> Any:
    """Pointer to a value of type ``kind`` that begins at a flat index of an array."""
    array_type, array_value = array
    data = context.make_array(array_type)(context, builder, array_value).data
    return builder.bitcast(builder.gep(data, [index]), _vector(kind).as_pointer())


def _load_typed(_typing: Any, array: Any, _index: Any, width: Any) -> Any:
    kind = _of_width(len(width))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, (signature.args[0], args[0]), args[1], kind)
        value = builder.load(address)
        value.align = 8  # arrays begin where they like
        return value

    return kind(array, types.intp, width), codegen


def _store_typed(_typing: Any, array: Any, _index: Any, value: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, (signature.args[0], args[0]), args[1], value)
        builder.store(args[2], address).align = 8
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


def _fill_typed(_typing: Any, value: Any, width: Any) -> Any:
    kind = _of_width(len(width))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _widened(context, builder, args[0], signature.args[0], kind)

    return kind(value, width), codegen


def _where_less_typed(_typing: Any, a: Any, b: Any, x: Any, y: Any) -> Any:
    kind = _common((a, b, x, y)) or types.float64

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        left, right, first, second = (
            _widened(context, builder, value, given, kind)
            for value, given in zip(args, signature.args, strict=True)
        )
        return builder.select(builder.fcmp_ordered("<", left, right), first, second)

    return kind(a, b, x, y), codegen


def _power_of_two_typed(_typing: Any, kind: Any) -> Any:
    def codegen(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], _vector(kind, _INTEGER))
        exponent = builder.shl(bits, _constant(kind, _INTEGER, 52))
        one = _constant(kind, _INTEGER, 0x3FF0000000000000)
        return builder.bitcast(builder.add(exponent, one), _vector(kind))

    return kind(kind), codegen


_load = cast("Callable[[NDArray[float64], int, Tag], float]", intrinsic(_load_typed))
_store = cast("Callable[[NDArray[float64], int, float], None]", intrinsic(_store_typed))
_fill = cast("Callable[[float, Tag], float]", intrinsic(_fill_typed))
_where_less = cast("Callable[[float, float, float, float], float]", intrinsic(_where_less_typed))
_power_of_two = cast("Callable[[float], float]", intrinsic(_power_of_two_typed))


@compiled
def load(array: NDArray[float64], index: int, width: Tag) -> float:
    """Numbers of a C-contiguous array from a flat index on, as many as ``width`` has elements."""
    return _load(array, index, width)


@compiled
def store(array: NDArray[float64], index: int, value: float) -> None:
    """Put the numbers of a value into a C-contiguous array from a flat index on."""
    _store(array, index, value)


@compiled
def fill(value: float, width: Tag) -> float:
    """One float in every lane."""
    return _fill(value, width)


@compiled
def where_less(a: float, b: float, x: float, y: float) -> float:
    """``x`` in lanes where a < b, else ``y`` (also where one of the two is not a number)."""
    return _where_less(a, b, x, y)


@compiled
def power_of_two(rounded: float) -> float:
    """2**k from the float ``k + 1.5 * 2**52``, the lowest bits of which hold the integer k."""
    return _power_of_two(rounded)
