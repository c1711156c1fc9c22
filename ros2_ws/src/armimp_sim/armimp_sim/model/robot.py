"""The exoskeleton: a planar chain of n links in the horizontal plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanarChain:
    """Rigid links in series, turning about parallel vertical axes (so no gravity).

    Raises
    ------
    ConfigurationError
        If shapes disagree, a value is negative or not finite, or a link is lighter to turn about
        its joint than a point mass in its centre would be, so that M_r might be indefinite.
    """

    lengths: NDArray[np.float64]
    """(n,) joint to next joint, m."""
    moments: NDArray[np.float64]
    """(n,) moment of inertia of each link about its own joint, I + m·lg², kg·m²."""
    masses: NDArray[np.float64]
    """(n,) kg (that of the first link has no effect beyond ``moments``)."""
    centres: NDArray[np.float64]
    """(n,) joint to centre of mass lg, m (likewise)."""

    def __post_init__(self) -> None:
        n = self.lengths.size
        for name in ("lengths", "moments", "masses", "centres"):
            values = getattr(self, name)
            if values.shape != (n,):
                raise ConfigurationError(f"robot: {name} is {values.shape}, expected {(n,)}")
            if not np.all(values >= 0.0) or not np.all(np.isfinite(values)):
                raise ConfigurationError(
                    f"robot: {name} must not be negative, got {values.tolist()}"
                )
        for i, value in enumerate(self.moments):
            if not value > 0.0:
                raise ConfigurationError(
                    f"robot: moment of inertia of link {i + 1} must be positive, got {value}"
                )
            smallest = self.masses[i] * self.centres[i] ** 2 if i > 0 else 0.0
            if not value >= smallest:
                raise ConfigurationError(
                    f"robot: moment of inertia of link {i + 1} about its joint must be at least "
                    f"m·lg² = {smallest:.3g} kg·m², got {value}"
                )

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return self.lengths.size

    def coefficients(self) -> NDArray[np.float64]:
        """A (n, n), kg·m²: kinetic energy is ½ Σ_ab A_ab cos(φ_a − φ_b) φ̇_a φ̇_b.

        The angles φ of the links are absolute: φ_a = θ_1 + … + θ_a.
        """
        n = self.joints
        carried = np.array([self.masses[a + 1 :].sum() for a in range(n)])
        first_moment = self.masses * self.centres + carried * self.lengths
        a = np.empty((n, n))
        for i in range(n):
            a[i, i] = self.moments[i] + self.lengths[i] ** 2 * carried[i]
            for j in range(i + 1, n):
                a[i, j] = a[j, i] = self.lengths[i] * first_moment[j]
        return a

    def mass_matrix(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """M_r(θ) (n, n), kg·m², at the joint angles ``theta`` (n,), rad."""
        phi = np.cumsum(theta)
        absolute = self.coefficients() * np.cos(phi[:, None] - phi[None, :])
        return _suffix_sums(_suffix_sums(absolute, 0), 1)


def _suffix_sums(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    return np.flip(np.cumsum(np.flip(values, axis), axis), axis)
