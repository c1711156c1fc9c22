"""The second-order impedance model of the arm."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError

UNITS: Final = {"M": "kg·m²", "B": "N·m·s/rad", "K": "N·m/rad"}


@dataclass(frozen=True, kw_only=True, eq=False)
class MBK:
    """Inertia, viscosity and stiffness matrices of ``Z(s) = M s² + B s + K``.

    The matrices are general: they need not be symmetric.

    Raises
    ------
    ConfigurationError
        If they are not square matrices of one size, or not finite.
    """

    M: FloatArray
    """Inertia, kg·m²; shape (n, n)."""
    B: FloatArray
    """Viscosity, N·m·s/rad; shape (n, n)."""
    K: FloatArray
    """Stiffness, N·m/rad; shape (n, n)."""

    def __post_init__(self) -> None:
        for name in ("M", "B", "K"):
            values: FloatArray = np.array(getattr(self, name), dtype=np.float64, order="C")
            n = len(self.M)
            if values.shape != (n, n):
                raise ConfigurationError(f"{name} has shape {values.shape}, expected ({n}, {n})")
            if not np.isfinite(values).all():
                raise ConfigurationError(f"{name} is not finite: {values.tolist()}")
            object.__setattr__(self, name, values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MBK) and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in ("M", "B", "K")
        )

    def __hash__(self) -> int:
        return self.joints

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.M)

    def impedance(self, f: FloatArray) -> ComplexArray:
        """Impedance, N·m/rad, shape (n, n, n_freq), at frequencies `f` in Hz."""
        return impedance_of(np.stack((self.M, self.B, self.K)), f)


def impedance_of(values: FloatArray, f: FloatArray) -> ComplexArray:
    """Impedance, (..., n_freq), of values of M, B and K, (3, ...), at frequencies in Hz."""
    M, B, K = values[..., None]
    omega = 2.0 * np.pi * f
    return np.asarray(K - M * omega**2 + 1j * (B * omega), dtype=np.complex128)
