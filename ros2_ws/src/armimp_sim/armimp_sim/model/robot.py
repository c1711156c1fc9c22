"""The exoskeleton: a planar chain of n links in the horizontal plane, and its drives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from armimp_common.errors import ConfigurationError
from armimp_common.schema import Schema

_SLOWEST = 2.0  # Hz; no drive has less


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


class ActuatorParameters(Schema):
    """Drives, all alike: a command is late, limited, and followed by a current loop.

    On the torque of the loop come ripple, in proportion to it, and cogging, both by the angle of
    the joint.
    """

    bandwidth: float = Field(default=0.0, ge=0.0, le=1e5)
    """Bandwidth of the current loop of the drives, of first order (Hz); 0 for no lag at all."""
    delay: float = Field(default=0.0, ge=0.0, le=0.02)
    """Delay with which commands act (s), rounded to steps of the integration."""
    limit: float = Field(default=0.0, ge=0.0)
    """Largest torque of a drive (N·m); 0 for no limit."""
    ripple: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Amplitude of the torque ripple as a share of the torque of the drive (–)."""
    ripple_cycles: float = Field(default=60.0, gt=0.0)
    """Periods of the torque ripple in a turn of the joint (–)."""
    cogging: float = Field(default=0.0, ge=0.0)
    """Amplitude of the cogging torque of a drive (N·m)."""
    cogging_cycles: float = Field(default=120.0, gt=0.0)
    """Periods of the cogging in a turn of the joint (–)."""

    @field_validator("bandwidth")
    @classmethod
    def _not_slower_than_any_drive(cls, bandwidth: float) -> float:
        if 0.0 < bandwidth < _SLOWEST:
            raise ValueError(f"must be 0 or at least {_SLOWEST:g}")
        return bandwidth

    @property
    def lag(self) -> float:
        """Time constant of the current loop, s; 0 for none."""
        return 1.0 / (2.0 * math.pi * self.bandwidth) if self.bandwidth else 0.0

    @property
    def direct(self) -> bool:
        """Whether the torque on the joint is what is commanded."""
        return not any((self.bandwidth, self.delay, self.limit, self.ripple, self.cogging))
