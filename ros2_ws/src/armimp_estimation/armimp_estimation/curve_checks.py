"""Whether what stands in a file of impedance curves can be what was written there."""

import struct
import tokenize
import zipfile
import zlib
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from armimp_estimation.results import ImpedanceCurve

UNREADABLE: Final = (
    *(OSError, ValueError, LookupError, TypeError, SyntaxError, EOFError),
    *(ArithmeticError, MemoryError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, struct.error),
    tokenize.TokenError,  # headers of arrays are Python literals
)
"""All that zipfile and numpy let out when bytes of an archive have changed."""


def check_curve(name: str, curve: "ImpedanceCurve") -> None:
    """Check the arrays of one estimator.

    Raises
    ------
    ValueError
        If they have other shapes or types than they should, or a curve is not finite.
    """
    n, size, spectra = len(curve.Z), curve.f.size, curve.coherence
    for where, f in ((name, curve.f), ("the coherences", spectra.f)):
        if f.ndim != 1 or f.dtype.kind != "f" or not f.size or not (np.diff(f) > 0.0).all():
            raise ValueError(f"the frequencies of {where} are not an ascending row of numbers")
    square = (n, n, size)
    expected = {
        f"Z_{name}": (curve.Z, square, "c"),
        f"T_{name}": (curve.T, square, "c"),
        f"R_{name}": (curve.R, square, "c"),
        f"var_{name}": (curve.variance, square, "f"),
        f"correlation_{name}": (curve.correlation, (curve.correlation.size,), "f"),
        f"covariance_{name}": (curve.covariance, (n, 2 * n, 2 * n, size), "c"),
        f"disturbance_{name}": (curve.disturbance, (n, n, n, size), "c"),
        f"inverse_{name}": (curve.inverse, square, "c"),
        f"systematics_{name}": (curve.systematics, (len(curve.systematics), *square), "c"),
        "coherence_motion": (spectra.motion, (n, spectra.f.size), "f"),
        "coherence_torque": (spectra.torque, (n, n, spectra.f.size), "f"),
        f"derived_{name}": (spectra.derived, (n, n, spectra.f.size), "f"),
    }
    for key, (values, shape, kind) in expected.items():
        if values is not None and (values.shape != shape or values.dtype.kind != kind):
            raise ValueError(
                f"{key} has shape {values.shape} of {values.dtype} for {n} joints, "
                f"{size} frequencies"
            )
    for key in ("f", "Z", "T", "R"):
        if not np.isfinite(getattr(curve, key)).all():
            raise ValueError(f"{key}_{name} is not finite")
