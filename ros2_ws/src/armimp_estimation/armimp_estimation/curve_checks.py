"""Whether what stands in a file of impedance curves can be what was written there."""

import struct
import tokenize
import zipfile
import zlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

UNREADABLE: Final = (
    *(OSError, ValueError, LookupError, TypeError, SyntaxError, EOFError),
    *(ArithmeticError, MemoryError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, struct.error),
    tokenize.TokenError,  # headers of arrays are Python literals
)
"""All that zipfile and numpy let out when bytes of an archive have changed."""


def check_curve(name: str, f: NDArray[Any], Z: NDArray[Any], variance: NDArray[Any]) -> None:
    """Check the arrays of one estimator.

    Parameters
    ----------
    name : str
        The estimator.
    f : ndarray, shape (n_freq,)
        Frequencies, Hz.
    Z : ndarray, shape (n, n, n_freq)
        Impedance, N·m/rad.
    variance : ndarray, shape (n, n, n_freq)
        Variance of each complex value.

    Raises
    ------
    ValueError
        If they have other shapes or types, or Z is not finite.
    """
    if f.ndim != 1 or f.dtype.kind != "f" or not f.size or not (np.diff(f) > 0.0).all():
        raise ValueError(f"the frequencies of {name} are not an ascending row of numbers")
    if Z.ndim != 3 or Z.shape != (len(Z), len(Z), f.size) or Z.dtype.kind != "c":
        raise ValueError(f"Z_{name} has shape {Z.shape} of {Z.dtype} at {f.size} frequencies")
    if variance.shape != Z.shape or variance.dtype.kind != "f":
        raise ValueError(f"var_{name} has shape {variance.shape}, Z_{name} {Z.shape}")
    if not (np.isfinite(f).all() and np.isfinite(Z).all()):
        raise ValueError(f"Z_{name} is not finite")
