"""Plain PD locking: the negative control, which shows what the law of the study is needed for.

With encoders alone, once per tick of length L::

    locked joints      τ = K_p (θ_rd − θ) − K_d θ̇
    perturbed joint    τ = τ_Δ + K_rd (θ_rd − θ) − B_rd θ̇

where θ̇ = (θ_k − θ_{k−1})/L. Nothing compensates friction, inertia, coupling, or the torque of the
arm. So locked joints give way in proportion to their load, and the perturbed joint shows the
inertia and the friction of the robot on top of its target impedance.

The gains are those of a joint that carries the inertia M of the robot, given a natural frequency ω
and a damping ratio ζ: K_p = ω² M, K_d = 2ζω M. Assumption: ω = 25 rad/s, ζ = 1. What limits ω on a
rig is chatter, since one count δ of an encoder commands K_d δ/L: here 2.2 N·m at the shoulder at
resolution level 3, as much as its Coulomb friction at level 3. (Sampling alone would allow
450 rad/s.) The stiffness is then 221 and 113 N·m/rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.compiled import inlined
from armimp_control.laws import (
    DAMPING,
    INERTIA,
    MODEL_ROWS,
    PD,
    ROLE_ROWS,
    STIFFNESS,
    THETA_1,
    TICKS,
    TargetLaw,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class PdConfig(TargetLaw):
    """Gains of plain PD locking."""

    inertia: FloatArray
    """(n,) M that the gains of locked joints are made for, kg·m²."""
    frequency: float = 25.0
    """Natural frequency ω of a locked joint, rad/s."""
    damping_ratio: float = 1.0
    """Its ζ."""

    kind: ClassVar[int] = PD
    gamma: ClassVar[float] = 0.0

    def model(self, _perturbed: int | None) -> FloatArray:
        """There is no internal model: (MODEL_ROWS, n, n) zeros."""
        return np.zeros((MODEL_ROWS, self.joints, self.joints))

    def role(self, perturbed: int | None) -> FloatArray:
        """Law parameters (ROLE_ROWS, n) while joint ``perturbed`` (0-based) yields, others lock.

        With None all joints yield, with NO_JOINT all lock. Rows as of
        :meth:`armimp_control.laws.imbic.ImbicConfig.role`; no joint senses τ_h.
        """
        locked, target = self.locked(perturbed), self.target
        rows = np.zeros((ROLE_ROWS, self.joints))
        rows[INERTIA] = self.inertia
        gain = 2.0 * self.damping_ratio * self.frequency * self.inertia
        rows[DAMPING] = np.where(locked, gain, target.damping)
        rows[STIFFNESS] = np.where(locked, self.frequency**2 * self.inertia, target.stiffness)
        return rows


@inlined
def pd(
    theta: FloatArray,
    tau_delta: FloatArray,
    role: FloatArray,
    target: FloatArray,
    period: float,
    memory: FloatArray,
    command: FloatArray,
) -> None:
    """One tick of the law, before the safety limiter.

    Parameters
    ----------
    theta, tau_delta : (n,) rad, N·m: encoders, perturbation
    role : (ROLE_ROWS, n) from :meth:`PdConfig.role`
    target : (n,) θ_rd, rad
    period : s
    memory : (MEMORY_ROWS, n), updated; zeros before the first tick
    command : (n,) N·m, written
    """
    n = theta.size
    if memory[TICKS, 0] == 0.0:
        for i in range(n):
            memory[THETA_1, i] = theta[i]
        memory[TICKS, 0] = 1.0
    for i in range(n):
        velocity = (theta[i] - memory[THETA_1, i]) / period
        memory[THETA_1, i] = theta[i]
        command[i] = (
            tau_delta[i] - role[DAMPING, i] * velocity - role[STIFFNESS, i] * (theta[i] - target[i])
        )
