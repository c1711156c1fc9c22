"""Several floating-point numbers as one value of compiled code: a SIMD register, or a few.

A compiler may or may not turn a loop over lanes into SIMD instructions, depending on the length of
the loop, on the code around it and on the compiler's version. This type leaves nothing to chance:
it is LLVM's own vector type, which uses the widest registers that the processor has. The same
functions also compile for a plain ``float``, operation by operation, so that a lane gives the same
bits alone and beside others.

Supported are ``+ - * /``, negation and ``abs`` between packed values and with floats, and the
functions below. To Python's type checker, a packed value is a ``float``.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled

Tag = tuple[float, ...]
"""Carries a compile-time constant: its number of elements."""

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


register_model(_Packed)(lambda manager, kind: models.PrimitiveModel(manager, kind, _vector(kind)))


def _common(kinds: Sequence[Any]) -> Any:
    """Return the packed type among ``kinds``, if all others are the same or floats; else None."""
    packed = {kind for kind in kinds if isinstance(kind, _Packed)}
    floats = all(isinstance(kind, _Packed | types.Float) for kind in kinds)
    return packed.pop() if floats and len(packed) == 1 else None


def _widened(context: Any, builder: Any, value: Any, kind: Any, target: Any) -> Any:
    """Put ``value`` into every lane of the type ``target``."""
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


def _absolute(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
    shape = args[0].type
    name = f"llvm.fabs.v{signature.return_type.width}f64"
    declared = ir.FunctionType(shape, [shape])
    return builder.call(cgutils.get_or_insert_function(builder.module, declared, name), args)


for _function, _instruction in _OPERATIONS.items():
    _define_operation(_function, _instruction)
_define_sign(operator.neg, lambda _context, builder, _signature, args: builder.fneg(args[0]))
_define_sign(abs, _absolute)


def _address(context: Any, builder: Any, array: Any, index: Any, kind: Any) -> Any:
    """Return a pointer to a value of type ``kind`` that begins at a flat index of an array."""
    array_type, array_value = array
    data = context.make_array(array_type)(context, builder, array_value).data
    return builder.bitcast(builder.gep(data, [index]), _vector(kind).as_pointer())


def _load_typed(_typing: Any, array: Any, _index: Any, tags: Any) -> Any:
    kind = _of_width(math.prod(map(len, tags.types)))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, (signature.args[0], args[0]), args[1], kind)
        value = builder.load(address)
        value.align = 8  # arrays need not be aligned to more than a double
        return value

    return kind(array, types.intp, tags), codegen


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


load = cast("Callable[[FloatArray, int, tuple[Tag, ...]], float]", intrinsic(_load_typed))
"""Read numbers of a C-contiguous array from a flat index on: the product of the tags' lengths."""
store = cast("Callable[[FloatArray, int, float], None]", intrinsic(_store_typed))
"""Write the numbers of a value into a C-contiguous array from a flat index on."""
fill = cast("Callable[[float, Tag], float]", intrinsic(_fill_typed))
"""Put one float into every lane."""
where_less = cast("Callable[[float, float, float, float], float]", intrinsic(_where_less_typed))
"""Given a, b, x, y: x in lanes where a < b, else y (also where a or b is not a number)."""
_power_of_two = cast("Callable[[float], float]", intrinsic(_power_of_two_typed))
"""2**k from the float ``k + 1.5 * 2**52``, the lowest bits of which hold the integer k."""

# --- elementary functions ------------------------------------------------------------------------
#
# A call of the C library's exp or sin in a loop over lanes keeps the compiler from vectorising it,
# and a vectorised library would round differently from the scalar one. These versions consist of
# additions, multiplications and one bit operation only, so a lane gives the same bits whether it
# runs alone or beside others. They are accurate to one or two units in the last place (tested
# against extended precision).

_LOG2_E = 1.4426950408889634
# ln 2 in two parts, the first with enough trailing zero bits that k * _LN2_HI is exact.
_LN2_HI = 6.93147180369123816490e-01
_LN2_LO = 1.90821492927058770002e-10
# Adding 1.5 * 2**52 rounds to the nearest integer, which then stands in the lowest bits.
_ROUNDER = 6755399441055744.0
_TWO_OVER_PI = 0.6366197723675814
# pi/2 in three parts, each but the last with trailing zero bits.
_PIO2_1 = 1.57079632673412561417e00
_PIO2_2 = 6.07710050630396597660e-11
_PIO2_3 = 2.02226624879595063154e-21
_LARGEST_EXPONENT = 700.0
# Taylor series, from the highest power down: the remainders are below 4e-18 for |r| <= ln(2)/2, and
# below 1e-19 for |r| <= pi/4.
_EXPONENTIAL = tuple(1.0 / math.factorial(k) for k in range(13, 1, -1))
_SINE = tuple((2 - k % 4) / math.factorial(k) for k in range(17, 1, -2))
_COSINE = tuple((1 - k % 4) / math.factorial(k) for k in range(18, 3, -2))


@compiled
def _series(x: float, coefficients: tuple[float, ...]) -> float:
    """Evaluate a polynomial with a multiple of four coefficients, every fourth on its own.

    A step of Horner's rule waits for the one before: four short rules take less time than one.
    """
    square = x * x
    fourth = square * square
    a, b = _horner(fourth, coefficients[::4]), _horner(fourth, coefficients[1::4])
    c, d = _horner(fourth, coefficients[2::4]), _horner(fourth, coefficients[3::4])
    return (a * x + b) * square + (c * x + d)


@compiled
def _horner(x: float, coefficients: tuple[float, ...]) -> float:
    total = x * coefficients[0] + coefficients[1]
    for k in range(2, len(coefficients)):
        total = total * x + coefficients[k]
    return total


@compiled
def exp_minus(y: float) -> float:
    """Compute the exponential of −y.

    Parameters
    ----------
    y : float
        Not negative. From 700 on the result stays at exp(−700) ≈ 1e-304, also for NaN.

    Returns
    -------
    float
        exp(−y), to about one unit in the last place.
    """
    y = where_less(y, _LARGEST_EXPONENT, y, _LARGEST_EXPONENT)
    shifted = _ROUNDER - y * _LOG2_E
    k = shifted - _ROUNDER
    r = (-y - k * _LN2_HI) - k * _LN2_LO
    return (1.0 + (r + r * r * _series(r, _EXPONENTIAL))) * _power_of_two(shifted)


@compiled
def sine_cosine(x: float) -> tuple[float, float]:
    """Compute sine and cosine at once.

    Parameters
    ----------
    x : float
        Angle, rad; |x| up to about 1e5.

    Returns
    -------
    tuple of float
        (sin x, cos x), each to about two units in the last place, also near its zeros.
    """
    # x = k·π/2 + r with |r| ≤ π/4
    k = (x * _TWO_OVER_PI + _ROUNDER) - _ROUNDER
    r = ((x - k * _PIO2_1) - k * _PIO2_2) - k * _PIO2_3
    # The quadrant, k modulo 4, by the same rounding trick: k/4 − 3/8 rounds to floor(k/4).
    q = k - 4.0 * (((k * 0.25 - 0.375) + _ROUNDER) - _ROUNDER)
    s = r * r
    sine = r + r * s * _series(s, _SINE)
    cosine = 1.0 - (0.5 * s - s * s * _series(s, _COSINE))
    # Odd quadrants swap the two; 2 and 3 turn the sign of the sine, 1 and 2 that of the cosine.
    odd = 1.0 - abs(abs(q - 2.0) - 1.0)
    s = where_less(odd, 0.5, sine, cosine)
    c = where_less(odd, 0.5, cosine, sine)
    return where_less(q, 2.0, s, -s), where_less(abs(q - 1.5), 1.0, -c, c)
