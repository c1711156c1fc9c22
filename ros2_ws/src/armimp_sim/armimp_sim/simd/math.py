"""Elementary functions that compile to straight-line, branch-free code.

The plant integrates many trials side by side, one per SIMD lane. A call of the C library's ``exp``
or ``sin`` in such a loop stops the compiler from vectorising it, and a vectorised library would
round differently from the scalar one. These versions consist of additions, multiplications and one
bit operation only, so a lane gives the same bits whether it runs alone or beside others.
They are accurate to one or two units in the last place (tested against extended precision).
"""

from __future__ import annotations

from armimp_common.compiled import compiled
from armimp_sim.simd.lanes import power_of_two, where_less

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


@compiled
def exp_minus(y: float) -> float:
    """Exponential of −y.

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
    # Taylor series of exp(r) for |r| <= ln(2)/2: the remainder is below 4e-18.
    p = 1.0 / 6227020800.0
    p = p * r + 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    return p * power_of_two(shifted)


@compiled
def _reduced(x: float) -> tuple[float, float]:
    """(r, q): x = q·π/2 + r with |r| ≤ π/4 and q reduced to 0, 1, 2 or 3."""
    k = (x * _TWO_OVER_PI + _ROUNDER) - _ROUNDER
    r = ((x - k * _PIO2_1) - k * _PIO2_2) - k * _PIO2_3
    # k modulo 4 by the same rounding trick: k/4 − 3/8 rounds to floor(k/4).
    quarter = ((k * 0.25 - 0.375) + _ROUNDER) - _ROUNDER
    return r, k - 4.0 * quarter


@compiled
def _sin_kernel(r: float) -> float:
    s = r * r
    p = 1.0 / 355687428096000.0
    p = p * s - 1.0 / 1307674368000.0
    p = p * s + 1.0 / 6227020800.0
    p = p * s - 1.0 / 39916800.0
    p = p * s + 1.0 / 362880.0
    p = p * s - 1.0 / 5040.0
    p = p * s + 1.0 / 120.0
    p = p * s - 1.0 / 6.0
    return r + r * s * p


@compiled
def _cos_kernel(r: float) -> float:
    s = r * r
    p = -1.0 / 6402373705728000.0
    p = p * s + 1.0 / 20922789888000.0
    p = p * s - 1.0 / 87178291200.0
    p = p * s + 1.0 / 479001600.0
    p = p * s - 1.0 / 3628800.0
    p = p * s + 1.0 / 40320.0
    p = p * s - 1.0 / 720.0
    p = p * s + 1.0 / 24.0
    return 1.0 - (0.5 * s - s * s * p)


@compiled
def sine_cosine(x: float) -> tuple[float, float]:
    """Sine and cosine at once.

    Parameters
    ----------
    x : float
        Angle, rad; |x| up to about 1e5.

    Returns
    -------
    tuple of float
        (sin x, cos x), each to about two units in the last place, also beside its zeros.
    """
    r, q = _reduced(x)
    sine, cosine = _sin_kernel(r), _cos_kernel(r)
    # Odd quadrants swap the two; 2 and 3 turn the sign of the sine, 1 and 2 that of the cosine.
    odd = 1.0 - abs(abs(q - 2.0) - 1.0)
    s = where_less(odd, 0.5, sine, cosine)
    c = where_less(odd, 0.5, cosine, sine)
    return where_less(q, 2.0, s, -s), where_less(abs(q - 1.5), 1.0, -c, c)
