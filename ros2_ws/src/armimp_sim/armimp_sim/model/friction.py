"""LuGre joint friction (Canudas de Wit et al., IEEE Trans. Autom. Control 40(3), 1995).

Bristles bend by z and slip: ``ż = v − σ0|v|z/g(v)``, ``g(v) = Fc + (Fs − Fc)·exp(−(v/vs)²)``, and
the friction is ``F = σ0 z + σ1 ż + σ2 v``. `armimp_sim.dynamics` integrates ż with the motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from armimp_common.compiled import compiled
from armimp_common.errors import ConfigurationError
from armimp_sim.simd import exp_minus


@dataclass(frozen=True, kw_only=True)
class LuGre:
    """ż = v − σ0|v|z/g(v), g(v) = Fc + (Fs − Fc)·exp(−(v/vs)²), F = σ0 z + σ1 ż + σ2 v.

    Raises
    ------
    ConfigurationError
        If a value is negative or not finite, Fs < Fc, or bristles have no friction level to reach.
    """

    coulomb: float
    static: float
    """Fc, Fs, N·m."""
    sigma_0: float
    """Bristle stiffness, N·m/rad."""
    sigma_1: float
    """Bristle damping, N·m·s/rad."""
    sigma_2: float
    """Viscous friction, N·m·s/rad."""
    stribeck_velocity: float = 0.01
    """Velocity vs, rad/s."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 <= value < math.inf:
                raise ConfigurationError(f"friction: {name} must not be negative, got {value}")
        if self.static < self.coulomb:
            raise ConfigurationError(
                f"friction: static level {self.static} is below Coulomb level {self.coulomb}"
            )
        if not self.stribeck_velocity > 0.0:
            raise ConfigurationError(
                f"friction: stribeck_velocity must be positive, got {self.stribeck_velocity}"
            )
        if self.sigma_0 > 0.0 and not self.coulomb > 0.0:
            raise ConfigurationError(
                f"friction: sigma_0 = {self.sigma_0} needs a positive Coulomb level"
            )

    @classmethod
    def none(cls) -> LuGre:
        """No friction at all."""
        return cls(coulomb=0.0, static=0.0, sigma_0=0.0, sigma_1=0.0, sigma_2=0.0)

    def scaled(self, factor: float) -> LuGre:
        """The same friction law with all torques multiplied by ``factor``."""
        return LuGre(
            coulomb=self.coulomb * factor,
            static=self.static * factor,
            sigma_0=self.sigma_0 * factor,
            sigma_1=self.sigma_1 * factor,
            sigma_2=self.sigma_2 * factor,
            stribeck_velocity=self.stribeck_velocity,
        )


@compiled
def bristle_force(v: float, coulomb: float, stribeck: float, inverse_velocity: float) -> float:
    """g(v), N·m, of Fc and Fs − Fc, N·m, and 1/vs, s/rad."""
    x = v * inverse_velocity
    return coulomb + stribeck * exp_minus(x * x)


@compiled
def lugre(
    v: float, z: float, level: float, sigma_0: float, sigma_1: float, sigma_2: float
) -> tuple[float, float]:
    """ż and F of a joint with velocity v, rad/s, and deflection z, rad, where g(v) is `level`."""
    dz = v - sigma_0 * abs(v) * z / level
    return dz, sigma_0 * z + sigma_1 * dz + sigma_2 * v
