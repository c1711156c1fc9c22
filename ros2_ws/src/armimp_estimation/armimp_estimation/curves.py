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
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.identify import EstimatorResult
from armimp_estimation.scores import Coherences

FRF_FILE = "frf.npz"


_MOST_BYTES: Final = 512 << 20

_UNREADABLE: Final = (
    *(OSError, ValueError, LookupError, TypeError, SyntaxError, EOFError),
    *(ArithmeticError, MemoryError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, struct.error),
    tokenize.TokenError,  # headers of arrays are Python literals
)
"""All that zipfile and numpy let out when bytes of an archive have changed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceCurve(ImpedanceEstimate):
    """What ``frf.npz`` holds of an estimate, its covariances in single precision."""

    coherence: Coherences
    """Over the frequencies of the spectra."""

    @classmethod
    def of(cls, result: EstimatorResult) -> ImpedanceCurve:
        """Return the curve of a result, with the precision that the file has."""
        estimate = result.estimate
        kept = {one.attribute: getattr(estimate, one.attribute) for one in _STORED.values()}
        for name in ("covariance", "disturbance"):
            kept[name] = None if kept[name] is None else kept[name].astype(np.complex64)
        return cls(name=estimate.name, f=estimate.f, coherence=result.coherence, **kept)


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
        arrays[f"systematics_{name}"] = np.array(curve.systematics).reshape(-1, *curve.Z.shape)
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
    except _UNREADABLE as error:
        text = getattr(error, "strerror", None) or str(error)
        reason = " ".join(text.split()) or type(error).__name__
        raise DataError(f"{path}: not a file of impedance curves: {reason}") from error
    return curves


def _curve(file: Any, name: str) -> ImpedanceCurve:
    """Read the arrays of one estimator.

    Raises
    ------
    ValueError
        If they have other shapes or types than they should, or a curve is not finite.
    """
    f = file[f"f_{name}" if f"f_{name}" in file.files else "f"]
    spectra = file["f_coherence"]
    for where, grid in ((name, f), ("the coherences", spectra)):
        ascends = grid.ndim == 1 and grid.dtype.kind == "f" and (np.diff(grid) > 0.0).all()
        if not ascends or not grid.size or not np.isfinite(grid).all():
            raise ValueError(f"the frequencies of {where} are not an ascending row of numbers")
    n = len(file[f"Z_{name}"])
    sizes = {"n": n, "m": 2 * n, "f": f.size, "s": spectra.size}

    def array(key: str, lengths: str, kind: str) -> NDArray[Any]:
        values: NDArray[Any] = file[key]
        fits = len(lengths) == values.ndim and all(
            sizes.get(letter, size) == size
            for letter, size in zip(lengths, values.shape, strict=False)
        )
        if not fits or values.dtype.kind != kind:
            raise ValueError(
                f"{key} has shape {values.shape} of {values.dtype} for {n} joints, "
                f"{f.size} frequencies"
            )
        return values

    found: dict[str, Any] = {
        one.attribute: array(f"{key}_{name}", one.lengths, one.kind)
        for key, one in _STORED.items()
        if f"{key}_{name}" in file.files or not one.optional
    }
    for key in ("Z", "T", "R"):
        if not np.isfinite(found[key]).all():
            raise ValueError(f"{key}_{name} is not finite")
    found["averages"], found["systematics"] = float(found["averages"]), tuple(found["systematics"])
    coherence = Coherences(
        f=spectra,
        motion=array("coherence_motion", "ns", "f"),
        torque=array("coherence_torque", "nns", "f"),
        derived=array(f"derived_{name}", "nns", "f"),
    )
    return ImpedanceCurve(name=name, f=f, coherence=coherence, **found)
