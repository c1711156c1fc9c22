"""Arrays by what they hold, for annotations; shapes are in the descriptions. Limits of numbers."""

from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
ComplexArray: TypeAlias = NDArray[np.complex128]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]

TINY: Final = float(np.finfo(np.float64).tiny)
"""Least normal number, which keeps divisors and arguments of logarithms above 0."""
EPS: Final = float(np.finfo(np.float64).eps)
"""Relative distance from 1 to the next number."""
