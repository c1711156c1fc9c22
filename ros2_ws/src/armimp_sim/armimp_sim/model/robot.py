"""The exoskeleton: a planar chain of n links in the horizontal plane, and its drives."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field, field_validator, model_validator

from armimp_common.arrays import FloatArray
from armimp_common.schema import NonNegativeVector, PositiveVector, Schema

_SLOWEST = 2.0  # Hz; no drive has a lower bandwidth


class PlanarChain(Schema):
    """The exoskeleton (assumption): rigid links in series.

    They turn about parallel vertical axes, so there is no gravity. Mass and centre of the first
    link have no effect beyond its moment of inertia.
    """

    lengths: NonNegativeVector
    """Length of each link of the robot (m)."""
    moments: PositiveVector
    """Moment of inertia of each link of the robot about its own joint (kg·m²)."""
    masses: NonNegativeVector
    """Mass of each link of the robot (kg)."""
    centres: NonNegativeVector
    """Distance from the joint to the centre of mass of each link of the robot (m)."""

    @model_validator(mode="after")
    def _are_bodies(self) -> PlanarChain:
        if len(set(map(len, dict(self).values()))) > 1:
            raise ValueError("there must be as many values of one kind as of the others")
        links = zip(self.moments[1:], self.masses[1:], self.centres[1:], strict=True)
        for i, (moment, mass, centre) in enumerate(links, 2):
            # Else M_r might be indefinite.
            if not moment >= (smallest := mass * centre**2):
                raise ValueError(
                    f"the moment of inertia of link {i} about its joint must be at least "
                    f"m·lg² = {smallest:.3g} kg·m², got {moment}"
                )
        return self

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.lengths)

    def coefficients(self) -> FloatArray:
        """Return A (n, n), kg·m²: the kinetic energy is ½ Σ_ab A_ab cos(φ_a − φ_b) φ̇_a φ̇_b.

        The angles φ of the links are absolute: φ_a = θ_1 + … + θ_a.
        """
        n, masses, lengths = self.joints, np.array(self.masses), np.array(self.lengths)
        carried = np.array([masses[a + 1 :].sum() for a in range(n)])
        first_moment = masses * self.centres + carried * lengths
        a = np.empty((n, n))
        for i in range(n):
            a[i, i] = self.moments[i] + lengths[i] ** 2 * carried[i]
            for j in range(i + 1, n):
                a[i, j] = a[j, i] = lengths[i] * first_moment[j]
        return a

    def mass_matrix(self, theta: FloatArray) -> FloatArray:
        """Return M_r(θ) (n, n), kg·m², at the joint angles ``theta`` (n,), rad."""
        phi = np.cumsum(theta)
        absolute = self.coefficients() * np.cos(phi[:, None] - phi[None, :])
        return _suffix_sums(_suffix_sums(absolute, 0), 1)


def _suffix_sums(values: FloatArray, axis: int) -> FloatArray:
    return np.flip(np.cumsum(np.flip(values, axis), axis), axis)


class ActuatorParameters(Schema):
    """Drives, all alike: a command is delayed, limited, and followed by a current loop.

    Ripple, in proportion to the torque of the loop, and cogging are added to it; both depend on the
    angle of the joint.
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
    """Periods of the torque ripple per turn of the joint (–)."""
    cogging: float = Field(default=0.0, ge=0.0)
    """Amplitude of the cogging torque of a drive (N·m)."""
    cogging_cycles: float = Field(default=120.0, gt=0.0)
    """Periods of the cogging per turn of the joint (–)."""

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
