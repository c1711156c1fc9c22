"""IMBIC: internal-model-based impedance control by time-delay estimation and ideal velocity.

The law (eq. 4–8 of the paper), once per tick k of length L::

    u    = M_rd⁻¹ [τ_Δ − τ_h' − B_rd θ̇ − K_rd (θ − θ_rd)]         desired acceleration
    v_id = ∫ u dt                                                ideal velocity
    τ_t  = τ_{t−L} + M̄ [u + Γ (v_id − θ̇) − θ̈_{t−L}]

with θ̇ = (θ_k − θ_{k−1})/L and θ̈_{t−L} = (θ_k − 2θ_{k−1} + θ_{k−2})/L². On the perturbed joint τ_h'
is the measured torque on the arm; on locked joints τ_h' = 0 and τ_Δ = 0 and the target is stiff,
so that they hold still whatever the arm does. τ_{t−L} is the command actually sent, after
saturation.

When a joint gets locked, its target starts where the joint is and goes to θ_rd from there: a stiff
target that jumps would ask for more torque than there is.

A locked joint can be given a dither: two sines in its target, above the band of the perturbation,
that move it by about a count of its encoder. A joint that is held to within a fraction of a count
is read with an error that follows perturbation and voluntary torque, and every estimate is biased
by it. With the dither readings are right on the mean: what is left of the error is in proportion
to the characteristic function of the motion at the resolution (Schuchman, IEEE Trans. Commun.
Technol. 12(4), 1964), here J_0(2π a/q)² for sines of amplitude a and a resolution q.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled
from armimp_common.errors import ConfigurationError
from armimp_control.laws.base import (
    APPROACH,
    COMMAND,
    DAMPING,
    DITHER,
    DITHER_ANGLE,
    IDEAL_VELOCITY,
    IMBIC,
    INERTIA,
    OFFSET,
    ROLE_ROWS,
    SENSED,
    SENSED_BEFORE,
    STIFFNESS,
    TARE,
    THETA_1,
    THETA_2,
    TICKS,
    check_numbers,
)

SECOND_TONE = 1.3
"""Frequency of the second sine of the dither, over that of the first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImbicConfig:
    """Target impedance and internal model.

    Parameters
    ----------
    target_posture : (n,) θ_rd, rad
    target_inertia : (n,) diagonal of M_rd, kg·m²
    target_damping : (n,) diagonal of B_rd of a joint while it is perturbed, N·m·s/rad
    target_stiffness : (n,) diagonal of K_rd of a joint while it is perturbed, N·m/rad
    lock_frequency : natural frequency ω of a locked joint's target, rad/s
    lock_damping_ratio : its ζ; so B_rd = 2ζω·M_rd and K_rd = ω²·M_rd
    model_inertia : (n, n) M̄, kg·m²
    gamma : Γ, rad/s
    period : L, s
    lock_approach : time constant with which the target of a joint that gets locked goes to θ_rd, s
    lock_dither : amplitude of each of two sines that a locked joint is to make, rad; 0 for none
    lock_dither_frequency : lower of their frequencies, Hz; the other is 1.3 times that

    Raises
    ------
    ConfigurationError
        If shapes disagree or a value is out of range.
    """

    target_posture: NDArray[np.float64]
    target_inertia: NDArray[np.float64]
    target_damping: NDArray[np.float64]
    target_stiffness: NDArray[np.float64]
    model_inertia: NDArray[np.float64]
    lock_frequency: float = 100.0
    lock_damping_ratio: float = 1.0
    gamma: float = 100.0
    period: float = 1e-3
    lock_approach: float = 0.05
    lock_dither: float = 0.0
    lock_dither_frequency: float = 35.0

    kind: ClassVar[int] = IMBIC

    def __post_init__(self) -> None:
        n = self.joints
        vectors = ("target_posture", "target_inertia", "target_damping", "target_stiffness")
        check_numbers(
            self,
            {**dict.fromkeys(vectors, (n,)), "model_inertia": (n, n)},
            (
                *("target_inertia", "lock_frequency", "lock_damping_ratio", "lock_approach"),
                *("gamma", "period"),
            ),
        )
        if not 0.0 <= self.lock_dither < np.inf:
            raise ConfigurationError(
                f"controller: lock_dither must not be negative, got {self.lock_dither}"
            )
        if not 0.0 < SECOND_TONE * self.lock_dither_frequency < 0.5 / self.period:
            raise ConfigurationError(
                "controller: lock_dither_frequency must lie between 0 and "
                f"{0.5 / self.period / SECOND_TONE:.4g} Hz, got {self.lock_dither_frequency}"
            )

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return self.target_posture.size

    def role(self, perturbed: int | None) -> NDArray[np.float64]:
        """Law parameters (8, n) while joint ``perturbed`` (0-based) yields and the others lock.

        With None all joints yield, with NO_JOINT all lock. Rows: share of τ_h' sensed (1 or 0),
        M_rd (kg·m²), B_rd (N·m·s/rad), K_rd (N·m/rad), what a tick leaves of the distance between
        target and θ_rd, amplitude (rad) and angle per tick (rad) of the dither in the target, tare
        (N·m; 0).
        """
        every = np.arange(self.joints)
        locked = every != (every if perturbed is None else perturbed)
        rows = np.empty((ROLE_ROWS, self.joints))
        rows[SENSED] = ~locked
        rows[INERTIA] = self.target_inertia
        rows[DAMPING] = np.where(
            locked,
            2.0 * self.lock_damping_ratio * self.lock_frequency * self.target_inertia,
            self.target_damping,
        )
        rows[STIFFNESS] = np.where(
            locked, self.lock_frequency**2 * self.target_inertia, self.target_stiffness
        )
        rows[APPROACH] = np.exp(-self.period / self.lock_approach)
        # The target has to move further than the joint, which follows like a low-pass.
        turning = 2.0 * np.pi * self.lock_dither_frequency
        ratio = math.sqrt(SECOND_TONE) * turning / self.lock_frequency
        attenuation = np.hypot(1.0 - ratio**2, 2.0 * self.lock_damping_ratio * ratio)
        rows[DITHER] = np.where(locked, self.lock_dither * attenuation, 0.0)
        rows[DITHER_ANGLE] = turning * self.period
        rows[TARE] = 0.0
        return rows


@compiled
def imbic(  # noqa: PLR0913, PLR0917 (compiled code takes no objects)
    theta: NDArray[np.float64],
    tau_h: NDArray[np.float64],
    tau_delta: NDArray[np.float64],
    role: NDArray[np.float64],
    target: NDArray[np.float64],
    model: NDArray[np.float64],
    gamma: float,
    period: float,
    memory: NDArray[np.float64],
    command: NDArray[np.float64],
) -> None:
    """One tick of the law, before the safety limiter.

    Parameters
    ----------
    theta, tau_h, tau_delta : (n,) rad, N·m, N·m: encoders, torque transducers, perturbation
    role : (8, n) from :meth:`ImbicConfig.role`
    target : (n,) θ_rd, rad
    model : (n, n) M̄, kg·m²
    gamma, period : rad/s, s
    memory : (MEMORY_ROWS, n), updated; zeros before the first tick; COMMAND holds what was sent
    command : (n,) N·m, written
    """
    n = theta.size
    ticks = memory[TICKS, 0]
    if ticks == 0.0:
        for i in range(n):
            memory[THETA_1, i] = memory[THETA_2, i] = theta[i]
    memory[TICKS, 0] = ticks + 1.0
    for i in range(n):
        goal = target[i]
        if role[SENSED, i] == 0.0:
            if ticks == 0.0 or memory[SENSED_BEFORE, i] != 0.0:
                memory[OFFSET, i] = theta[i] - target[i]
            else:
                memory[OFFSET, i] *= role[APPROACH, i]
            angle = role[DITHER_ANGLE, i] * ticks
            tones = math.sin(angle) + math.sin(SECOND_TONE * angle)
            goal += memory[OFFSET, i] + role[DITHER, i] * tones
        memory[SENSED_BEFORE, i] = role[SENSED, i]
        velocity = (theta[i] - memory[THETA_1, i]) / period
        u = (
            tau_delta[i]
            - role[SENSED, i] * (tau_h[i] - role[TARE, i])
            - role[DAMPING, i] * velocity
            - role[STIFFNESS, i] * (theta[i] - goal)
        ) / role[INERTIA, i]
        memory[IDEAL_VELOCITY, i] += period * u
        acceleration = (theta[i] - 2.0 * memory[THETA_1, i] + memory[THETA_2, i]) / (
            period * period
        )
        memory[THETA_2, i] = memory[THETA_1, i]
        memory[THETA_1, i] = theta[i]
        command[i] = u + gamma * (memory[IDEAL_VELOCITY, i] - velocity) - acceleration
    for i in range(n):
        total = memory[COMMAND, i]
        for j in range(n):
            total += model[i, j] * command[j]
        memory[COMMAND, i] = total
    for i in range(n):
        command[i] = memory[COMMAND, i]
