"""Impedance curves of a result, as ``frf.npz`` holds them."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import DataError
from armimp_estimation.atomic_write import open_regular, write_atomically
from armimp_estimation.identify import EstimatorResult
from armimp_estimation.scores import Coherences

FRF_FILE = "frf.npz"

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Complex64Array = NDArray[np.complex64]

_MOST_BYTES: Final = 512 << 20

_UNREADABLE: Final = (
    *(OSError, ValueError, LookupError, TypeError, SyntaxError, EOFError),
    *(ArithmeticError, MemoryError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, struct.error),
    tokenize.TokenError,  # headers of arrays are Python literals
)
"""All that zipfile and numpy let out when bytes of an archive have changed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceCurve:
    """What an estimator found over frequency, as ``frf.npz`` holds it.

    Attributes
    ----------
    f : ndarray, shape (n_freq,)
        Frequencies, Hz.
    Z, T, R : ndarray, shape (n, n, n_freq)
        Impedance (N·m/rad), and responses of torques and of angles (rad/(N·m)) behind it.
    variance : ndarray, shape (n, n, n_freq)
        Variance of each complex value of Z.
    averages : float
        Effective number of averages behind it, for confidence bands.
    correlation : ndarray, shape (lags,)
        Of the errors at neighbouring frequencies.
    systematics : ndarray, shape (errors, n, n, n_freq)
    covariance, disturbance, inverse : ndarray or None
        As those of :class:`armimp_estimation.estimators.estimate.ImpedanceEstimate`; the first two
        in single precision.
    coherence : Coherences
        Over the frequencies of the spectra.
    """

    f: FloatArray
    Z: ComplexArray
    T: ComplexArray
    R: ComplexArray
    variance: FloatArray
    averages: float
    correlation: FloatArray
    covariance: Complex64Array | None
    disturbance: Complex64Array | None
    inverse: ComplexArray | None
    systematics: ComplexArray
    coherence: Coherences

    @classmethod
    def of(cls, result: EstimatorResult) -> ImpedanceCurve:
        """That of a result, as it comes back from the file."""
        estimate = result.estimate
        covariance, disturbance = (
            None if values is None else values.astype(np.complex64)
            for values in (estimate.covariance, estimate.disturbance)
        )
        return cls(
            f=estimate.f,
            Z=estimate.Z,
            T=estimate.T,
            R=estimate.R,
            variance=estimate.variance,
            averages=estimate.averages,
            correlation=estimate.bin_correlation,
            covariance=covariance,
            disturbance=disturbance,
            inverse=estimate.inverse,
            systematics=np.array(estimate.systematics).reshape(-1, *estimate.Z.shape),
            coherence=result.coherence,
        )


def write_frf(path: Path, curves: Mapping[str, ImpedanceCurve]) -> None:
    """Write ``frf.npz``; ``docs/interfaces.md`` lists its arrays.

    ``f`` is the grid of the first estimator; one with another grid has its own ``f_<name>``.

    Raises
    ------
    DataError
        If there is no estimate, or the file exists already or cannot be written.
    """
    if not curves:
        raise DataError(f"{path}: no estimate to write")
    first = next(iter(curves.values()))
    arrays: dict[str, NDArray[Any] | None] = {
        "f": first.f,
        "f_coherence": first.coherence.f,
        "coherence_motion": first.coherence.motion,
        "coherence_torque": first.coherence.torque,
    }
    for name, curve in curves.items():
        arrays |= {
            f"f_{name}": None if np.array_equal(curve.f, first.f) else curve.f,
            f"Z_{name}": curve.Z,
            f"T_{name}": curve.T,
            f"R_{name}": curve.R,
            f"var_{name}": curve.variance,
            f"averages_{name}": np.array(curve.averages),
            f"correlation_{name}": curve.correlation,
            f"covariance_{name}": curve.covariance,
            f"disturbance_{name}": curve.disturbance,
            f"inverse_{name}": curve.inverse,
            f"systematics_{name}": curve.systematics,
            f"derived_{name}": curve.coherence.derived,
        }

    def save(part: Path) -> None:
        known = {name: values for name, values in arrays.items() if values is not None}
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **known)

    write_atomically(path, save)


def read_frf(path: Path) -> dict[str, ImpedanceCurve]:
    """Read ``frf.npz``: the curves by name of the estimator.

    Raises
    ------
    DataError
        If it cannot be read or lacks an array.
    """
    try:
        # Opened here, as numpy leaves a file that it cannot read open.
        with open_regular(path) as raw, np.load(raw, allow_pickle=False) as file:
            size = sum(entry.file_size for entry in file.zip.infolist())
            if size > _MOST_BYTES:
                raise ValueError(f"it holds {size} bytes")
            names = [key[2:] for key in file.files if key.startswith("Z_")]
            curves = {name: _curve(file, name) for name in names}
        for name, curve in curves.items():
            _check(name, curve)
    except _UNREADABLE as error:
        text = getattr(error, "strerror", None) or str(error)
        reason = " ".join(text.split()) or type(error).__name__
        raise DataError(f"{path}: not a file of impedance curves: {reason}") from error
    return curves


def _curve(file: Any, name: str) -> ImpedanceCurve:
    def optional(kind: str) -> Any:
        key = f"{kind}_{name}"
        return file[key] if key in file.files else None

    own = optional("f")
    return ImpedanceCurve(
        f=file["f"] if own is None else own,
        Z=file[f"Z_{name}"],
        T=file[f"T_{name}"],
        R=file[f"R_{name}"],
        variance=file[f"var_{name}"],
        averages=float(file[f"averages_{name}"]),
        correlation=file[f"correlation_{name}"],
        covariance=optional("covariance"),
        disturbance=optional("disturbance"),
        inverse=optional("inverse"),
        systematics=file[f"systematics_{name}"],
        coherence=Coherences(
            f=file["f_coherence"],
            motion=file["coherence_motion"],
            torque=file["coherence_torque"],
            derived=file[f"derived_{name}"],
        ),
    )


def _check(name: str, curve: ImpedanceCurve) -> None:
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
