"""Plain PD locking: the negative control, which shows why the law of the study is needed.

With encoders alone, once per tick of length L::

    locked joints      τ = K_p (θ_rd − θ) − K_d θ̇
    perturbed joint    τ = τ_Δ + K_rd (θ_rd − θ) − B_rd θ̇

where θ̇ = (θ_k − θ_{k−1})/L. Nothing compensates friction, inertia, coupling, or the torque of the
arm. So locked joints give way in proportion to their load, and the perturbed joint shows the
inertia and the friction of the robot on top of its target impedance.

The gains give a joint that carries the inertia M of the robot a natural frequency ω and a damping
ratio ζ: K_p = ω² M, K_d = 2ζω M. Assumption: ω = 25 rad/s, ζ = 1. On a rig, ω is limited by
chatter, since one encoder count δ commands K_d δ/L: here 2.2 N·m at the shoulder at resolution
level 3, as much as its Coulomb friction at level 3. (Sampling alone would allow 450 rad/s.) The
stiffness is then 221 and 113 N·m/rad.
"""

from __future__ import annotations

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled
from armimp_common.schema import matrix
from armimp_common.topics import PERIOD
from armimp_control.laws import (
    DAMPING,
    INERTIA,
    PD,
    POSTURE,
    ROLE_ROWS,
    STIFFNESS,
    THETA_1,
    TICKS,
    Law,
    LawArrays,
)


class Pd(Law):
    """Plain PD locking."""

    kind = PD

    def role(self, perturbed: int | None) -> FloatArray:
        """See :meth:`Law.role`; no joint senses τ_h."""
        locked, target, omega = self.locked(perturbed), self.target, self.law.pd_frequency
        inertia = np.diag(matrix("known.robot_inertia", self.known.robot_inertia, self.joints))
        rows = np.zeros((ROLE_ROWS, self.joints))
        rows[POSTURE], rows[INERTIA] = target.posture, inertia
        gain = 2.0 * self.law.pd_damping_ratio * omega * inertia
        rows[DAMPING] = np.where(locked, gain, target.damping)
        rows[STIFFNESS] = np.where(locked, omega**2 * inertia, target.stiffness)
        return rows


@compiled
def pd(arrays: LawArrays) -> None:
    """Compute the command of one tick."""
    theta, tau_delta = arrays.sample[0], arrays.sample[2]
    role, memory, command = arrays.role, arrays.memory, arrays.command
    n = theta.size
    if memory[TICKS, 0] == 0.0:
        for i in range(n):
            memory[THETA_1, i] = theta[i]
        memory[TICKS, 0] = 1.0
    for i in range(n):
        velocity = (theta[i] - memory[THETA_1, i]) / PERIOD
        memory[THETA_1, i] = theta[i]
        away = theta[i] - role[POSTURE, i]
        command[i] = tau_delta[i] - role[DAMPING, i] * velocity - role[STIFFNESS, i] * away
