"""LuGre joint friction (Canudas de Wit et al., IEEE Trans. Autom. Control 40(3), 1995).

Bristles bend by z and slip: ``ż = v − σ0|v|z/g(v)``, ``g(v) = Fc + (Fs − Fc)·exp(−(v/vs)²)``, and
the friction is ``F = σ0 z + σ1 ż + σ2 v``. `armimp_sim.dynamics` integrates ż with the motion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import model_validator

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled
from armimp_common.schema import NonNegativeVector, PositiveVector, Schema, each
from armimp_sim.simd import exp_minus

_TORQUES = ("coulomb", "static", "sigma_0", "sigma_1", "sigma_2")


class LuGre(Schema):
    """LuGre friction of the joints (assumption); each parameter has one value, or one per joint.

    By default there is none.
    """

    coulomb: NonNegativeVector = (0.0,)
    """Coulomb friction Fc of each joint (N·m)."""
    static: NonNegativeVector = (0.0,)
    """Static friction Fs of each joint (N·m)."""
    sigma_0: NonNegativeVector = (0.0,)
    """Bristle stiffness σ0 of the friction of each joint (N·m/rad)."""
    sigma_1: NonNegativeVector = (0.0,)
    """Bristle damping σ1 of the friction of each joint (N·m·s/rad)."""
    sigma_2: NonNegativeVector = (0.0,)
    """Viscous friction σ2 of each joint (N·m·s/rad)."""
    stribeck_velocity: PositiveVector = (0.01,)
    """Stribeck velocity vs of each joint (rad/s)."""

    @model_validator(mode="after")
    def _has_levels(self) -> LuGre:
        if len({len(values) for _, values in self} - {1}) > 1:
            raise ValueError("where there are several values, there must be equally many")
        coulomb, static, sigma_0 = map(np.array, (self.coulomb, self.static, self.sigma_0))
        if not np.all(static >= coulomb):
            raise ValueError(f"static {self.static} must not be below coulomb {self.coulomb}")
        if np.any((sigma_0 > 0.0) & (coulomb == 0.0)):
            raise ValueError(f"sigma_0 {self.sigma_0} needs a positive coulomb, got {self.coulomb}")
        return self

    def of_joints(self, n: int) -> dict[str, FloatArray]:
        """Return the values (n,) for `n` joints by name.

        Raises
        ------
        ConfigurationError
            If a parameter has neither 1 nor n values.
        """
        return {name: each(f"friction.{name}", values, n) for name, values in self}

    def scaled(self, factors: Sequence[float]) -> LuGre:
        """Return this friction with all torques of each joint multiplied by its factor (n,)."""
        values = self.of_joints(len(factors))
        values |= {name: values[name] * factors for name in _TORQUES}
        return LuGre.model_validate({name: one.tolist() for name, one in values.items()})


@compiled
def bristle_force(v: float, coulomb: float, stribeck: float, inverse_velocity: float) -> float:
    """Return g(v), N·m, for Fc and Fs − Fc, N·m, and 1/vs, s/rad."""
    x = v * inverse_velocity
    return coulomb + stribeck * exp_minus(x * x)


@compiled
def lugre(
    v: float, z: float, level: float, sigma_0: float, sigma_1: float, sigma_2: float
) -> tuple[float, float]:
    """Return ż and F of a joint with velocity v, rad/s, deflection z, rad, and g(v) = `level`."""
    dz = v - sigma_0 * abs(v) * z / level
    return dz, (sigma_0 * z + sigma_2 * v) + sigma_1 * dz
