"""Impedance curves of a result, as ``frf.npz`` holds them."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

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
    bin_correlation : ndarray, shape (lags, n_freq)
        Of the errors at each frequency and those above it.
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
    bin_correlation: FloatArray
    covariance: Complex64Array | None
    disturbance: Complex64Array | None
    inverse: ComplexArray | None
    systematics: ComplexArray
    coherence: Coherences

    @classmethod
    def of(cls, result: EstimatorResult) -> ImpedanceCurve:
        """Return the curve of a result, with the precision that the file has."""
        estimate = result.estimate
        kept = {one.attribute: getattr(estimate, one.attribute) for one in _STORED.values()}
        for name in ("covariance", "disturbance"):
            kept[name] = None if kept[name] is None else kept[name].astype(np.complex64)
        kept["systematics"] = np.array(estimate.systematics).reshape(-1, *estimate.Z.shape)
        return cls(f=estimate.f, coherence=result.coherence, **kept)


class _Stored(NamedTuple):
    """An array of a curve in the file: attribute, lengths, and kind of its numbers.

    Lengths are those of joints (n), angles and torques (m) and frequencies (f), or any (-).
    """

    attribute: str
    lengths: str
    kind: str
    optional: bool = False


_STORED: Final[Mapping[str, _Stored]] = {
    "Z": _Stored("Z", "nnf", "c"),
    "T": _Stored("T", "nnf", "c"),
    "R": _Stored("R", "nnf", "c"),
    "var": _Stored("variance", "nnf", "f"),
    "averages": _Stored("averages", "", "f"),
    "correlation": _Stored("bin_correlation", "-f", "f"),
    "covariance": _Stored("covariance", "nmmf", "c", optional=True),
    "disturbance": _Stored("disturbance", "nnnf", "c", optional=True),
    "inverse": _Stored("inverse", "nnf", "c", optional=True),
    "systematics": _Stored("systematics", "-nnf", "c"),
}
"""By the beginning of its name in the file, which the name of the estimator follows."""


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
        arrays[f"f_{name}"] = None if np.array_equal(curve.f, first.f) else curve.f
        arrays |= {f"{key}_{name}": getattr(curve, one.attribute) for key, one in _STORED.items()}
        arrays[f"derived_{name}"] = curve.coherence.derived

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
    found: dict[str, Any] = {
        one.attribute: file[f"{key}_{name}"]
        if f"{key}_{name}" in file.files or not one.optional
        else None
        for key, one in _STORED.items()
    }
    found["averages"] = float(found["averages"])
    return ImpedanceCurve(
        f=file[f"f_{name}" if f"f_{name}" in file.files else "f"],
        coherence=Coherences(
            f=file["f_coherence"],
            motion=file["coherence_motion"],
            torque=file["coherence_torque"],
            derived=file[f"derived_{name}"],
        ),
        **found,
    )


def _check(name: str, curve: ImpedanceCurve) -> None:
    """Check the arrays of one estimator.

    Raises
    ------
    ValueError
        If they have other shapes or types than they should, or a curve is not finite.
    """
    n, spectra = len(curve.Z), curve.coherence
    for where, f in ((name, curve.f), ("the coherences", spectra.f)):
        if f.ndim != 1 or f.dtype.kind != "f" or not f.size or not (np.diff(f) > 0.0).all():
            raise ValueError(f"the frequencies of {where} are not an ascending row of numbers")
    arrays = {
        f"{key}_{name}": (np.asarray(getattr(curve, one.attribute)), one.lengths, one.kind)
        for key, one in _STORED.items()
        if getattr(curve, one.attribute) is not None
    }
    arrays["coherence_motion"] = (spectra.motion, "ns", "f")
    arrays["coherence_torque"] = (spectra.torque, "nns", "f")
    arrays[f"derived_{name}"] = (spectra.derived, "nns", "f")
    sizes = {"n": n, "m": 2 * n, "f": curve.f.size, "s": spectra.f.size}
    for key, (values, lengths, kind) in arrays.items():
        fits = len(lengths) == values.ndim and all(
            sizes.get(letter, size) == size
            for letter, size in zip(lengths, values.shape, strict=False)
        )
        if not fits or values.dtype.kind != kind:
            raise ValueError(
                f"{key} has shape {values.shape} of {values.dtype} for {n} joints, "
                f"{curve.f.size} frequencies"
            )
    for key in ("f", "Z", "T", "R"):
        if not np.isfinite(getattr(curve, key)).all():
            raise ValueError(f"{key}_{name} is not finite")
