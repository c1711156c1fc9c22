"""IMBIC: internal-model-based impedance control with ideal velocity, and two internal models.

The law (eq. 4–8 of the paper), once per tick k of length L::

    u    = M_rd⁻¹ [τ_Δ − τ_h' − B_rd θ̇ − K_rd (θ − θ_rd)]         desired acceleration
    v_id = ∫ u dt                                                ideal velocity

On the perturbed joint τ_h' is the measured torque on the arm; on locked joints τ_h' = 0 and τ_Δ = 0
and the target is stiff, so that they hold still whatever the arm does. Then, by time-delay
estimation,

    τ_t  = τ_{t−L} + M̄ [u + Γ (v_id − θ̇) − θ̈_{t−L}]

with θ̇ = (θ_k − θ_{k−1})/L and θ̈_{t−L} = (θ_k − 2θ_{k−1} + θ_{k−2})/L², where τ_{t−L} is the command
actually sent, after saturation. Here one encoder count δ makes a torque of M̄ δ/L². The alternative
is an observer of angles θ̂, velocities v̂, and accelerations d̂ that no known torque explains. Its
estimates also replace θ and the differences in u, and the law is

    τ_t  = M̄ [u + Γ (v_id − v̂) − d̂] + τ_h .

The torque on the arm is measured, so the observer has to model the robot alone::

    a  = M̄⁻¹ (τ_{t−(1+D)L} − τ_h) + d̂
    e  = θ − (θ̂ + L v̂ + L²a/2)
    θ̂ ← θ̂ + L v̂ + L²a/2 + G_θ e,    v̂ ← v̂ + L a + G_v e,    d̂ ← d̂ + G_d e

where τ_{t−(1+D)L} is the command that acted, as commands are known to act D periods late.

When a joint gets locked, its target starts at the position of the joint and moves to θ_rd from
there: a stiff target that jumps would ask for more torque than is available.

A locked joint can be given a dither: two sines in its target, above the band of the perturbation,
that move it by about a count of its encoder. The reading of a joint that is held to within a
fraction of a count has an error that depends on perturbation and voluntary torque, and that biases
every estimate. With the dither, readings are right on average: the error that remains is
proportional to the characteristic function of the motion at the resolution (Schuchman, IEEE Trans.
Commun. Technol. 12(4), 1964), here J_0(2π a/q)² for sines of amplitude a and a resolution q.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from armimp_common.arrays import BoolArray, FloatArray
from armimp_common.compiled import compiled
from armimp_common.schema import each, matrix
from armimp_common.topics import PERIOD
from armimp_control.laws import (
    ANGLE,
    ANGLE_GAIN,
    APPROACH,
    COMMAND,
    DAMPING,
    DISTURBANCE,
    DISTURBANCE_GAIN,
    DITHER,
    DITHER_ANGLE,
    GAMMA,
    IDEAL_VELOCITY,
    IMBIC,
    IMBIC_OBSERVER,
    INERTIA,
    INERTIA_MODEL,
    INVERSE,
    LATE,
    OFFSET,
    POSTURE,
    ROLE_ROWS,
    SECOND_TONE,
    SENSED,
    SENSED_BEFORE,
    STIFFNESS,
    TARE,
    THETA_1,
    THETA_2,
    TICKS,
    VELOCITY,
    VELOCITY_GAIN,
    Law,
    LawArrays,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Imbic(Law):
    """Target impedance with an internal model: an observer, or time-delay estimation."""

    _models: dict[int | None, FloatArray] = field(default_factory=dict, init=False, repr=False)

    @property
    def kind(self) -> int:
        """Code of the law with the chosen one of the two internal models."""
        return IMBIC_OBSERVER if self.law.internal_model == "observer" else IMBIC

    def model(self, perturbed: int | None) -> FloatArray:
        """See :meth:`Law.model`; don't modify the result.

        Computing the gains takes some ten control periods, so models are kept.
        """
        if perturbed not in self._models:
            rows = super().model(perturbed)
            inertia = matrix("law.model_inertia", self.law.model_inertia, self.joints)
            rows[INERTIA_MODEL] = inertia
            if self.kind == IMBIC_OBSERVER:
                rows[INVERSE] = np.linalg.inv(inertia)
                rows[ANGLE_GAIN:] = self._gains(rows[INVERSE], self.locked(perturbed))
            self._models[perturbed] = rows
        return self._models[perturbed]

    def _gains(self, inverse: FloatArray, locked: BoolArray) -> FloatArray:
        """Return G_θ, G_v (1/s) and G_d (1/s²), (3, n, n), of a steady-state Kalman filter.

        Rounding of encoders is modelled as white noise of variance δ²/12, and unknown torques,
        mostly friction, as random walks. They act on all joints through M̄⁻¹, so friction that shows
        in the motion of the perturbed joint is known at the locked joints before they move.
        """
        # Imported here, so that other laws need not wait for it.
        from scipy.linalg import solve_discrete_are

        n, law = len(inverse), self.law
        unit, none = np.eye(n), np.zeros((n, n))
        # The state: angles, velocities, and the unknown torques that oppose them.
        transition = np.block(
            [
                [unit, PERIOD * unit, -0.5 * PERIOD**2 * inverse],
                [none, unit, -PERIOD * inverse],
                [none, none, unit],
            ]
        )
        reads = np.hstack([unit, none, none])
        walk = np.zeros((3 * n, 3 * n))
        while_locked = each("law.locked_walk", law.locked_walk, n)
        while_perturbed = each("law.perturbed_walk", law.perturbed_walk, n)
        walk[2 * n :, 2 * n :] = np.diag(np.where(locked, while_locked, while_perturbed) ** 2)
        rounding = law.encoder_resolution**2 / 12.0 * unit
        covariance = solve_discrete_are(transition.T, reads.T, walk, rounding)
        innovation = reads @ covariance @ reads.T + rounding
        solved = np.linalg.solve(innovation, reads @ covariance)
        gains: FloatArray = solved.T.reshape(3, n, n)
        gains[2] = -inverse @ gains[2]
        return gains

    def role(self, perturbed: int | None) -> FloatArray:
        """See :meth:`Law.role`; for the rows, :data:`armimp_control.laws.ROLE_ROWS`."""
        locked = self.locked(perturbed)
        target, rows = self.target, np.empty((ROLE_ROWS, self.joints))
        rows[SENSED] = ~locked
        rows[INERTIA] = target.inertia
        rows[DAMPING], rows[STIFFNESS] = target.damping, target.stiffness
        if (frequency := target.lock_frequency) > 0.0:
            inertia = rows[INERTIA, locked]
            rows[DAMPING, locked] = 2.0 * target.lock_damping_ratio * frequency * inertia
            rows[STIFFNESS, locked] = frequency**2 * inertia
        approach = target.lock_approach
        rows[APPROACH] = np.exp(-PERIOD / approach) if approach else 0.0
        # The target has to move further than the joint, which follows like a low-pass.
        turning = 2.0 * np.pi * target.lock_dither_frequency
        moving = 1j * math.sqrt(SECOND_TONE) * turning
        stiffness = rows[STIFFNESS]
        asked = (rows[INERTIA] * moving + rows[DAMPING]) * moving + stiffness
        attenuation = np.abs(asked) / np.where(stiffness > 0.0, stiffness, np.inf)
        rows[DITHER] = np.where(locked, target.lock_dither * attenuation, 0.0)
        rows[DITHER_ANGLE] = turning * PERIOD
        rows[TARE] = 0.0
        rows[POSTURE], rows[GAMMA] = target.posture, self.law.gamma
        rows[LATE] = self.known.command_delay if self.kind == IMBIC_OBSERVER else 0.0
        return rows


@compiled
def _observe(arrays: LawArrays) -> None:
    """Update ANGLE, VELOCITY and DISTURBANCE with this sample; ``command`` is work space."""
    theta, tau_h, command = arrays.sample[0], arrays.sample[1], arrays.command
    role, model, memory = arrays.role, arrays.model, arrays.memory
    n, late = theta.size, int(role[LATE, 0])
    for i in range(n):
        command[i] = memory[COMMAND + late, i] - (tau_h[i] - role[TARE, i])
        for row in range(COMMAND + late, COMMAND, -1):
            memory[row, i] = memory[row - 1, i]
    for i in range(n):
        acceleration = memory[DISTURBANCE, i]
        for j in range(n):
            acceleration += model[INVERSE, i, j] * command[j]
        memory[ANGLE, i] += PERIOD * (memory[VELOCITY, i] + 0.5 * PERIOD * acceleration)
        memory[VELOCITY, i] += PERIOD * acceleration
    for i in range(n):
        command[i] = theta[i] - memory[ANGLE, i]
    for i in range(n):
        for j in range(n):
            memory[ANGLE, i] += model[ANGLE_GAIN, i, j] * command[j]
            memory[VELOCITY, i] += model[VELOCITY_GAIN, i, j] * command[j]
            memory[DISTURBANCE, i] += model[DISTURBANCE_GAIN, i, j] * command[j]


@compiled
def imbic(observer: bool, arrays: LawArrays) -> None:
    """Compute the command of one tick, by the observer or by time-delay estimation."""
    theta, tau_h, tau_delta = arrays.sample[0], arrays.sample[1], arrays.sample[2]
    role, model, memory, command = arrays.role, arrays.model, arrays.memory, arrays.command
    n, gamma = theta.size, role[GAMMA, 0]
    ticks = memory[TICKS, 0]
    if ticks == 0.0:
        for i in range(n):
            memory[THETA_1, i] = memory[THETA_2, i] = memory[ANGLE, i] = theta[i]
    elif observer:
        _observe(arrays)
    memory[TICKS, 0] = ticks + 1.0
    for i in range(n):
        goal = role[POSTURE, i]
        if role[SENSED, i] == 0.0:
            if ticks == 0.0 or memory[SENSED_BEFORE, i] != 0.0:
                memory[OFFSET, i] = theta[i] - role[POSTURE, i]
            else:
                memory[OFFSET, i] *= role[APPROACH, i]
            angle = role[DITHER_ANGLE, i] * ticks
            tones = math.sin(angle) + math.sin(SECOND_TONE * angle)
            goal += memory[OFFSET, i] + role[DITHER, i] * tones
        memory[SENSED_BEFORE, i] = role[SENSED, i]
        if observer:
            angle, velocity = memory[ANGLE, i], memory[VELOCITY, i]
            known = memory[DISTURBANCE, i]
        else:
            angle, velocity = theta[i], (theta[i] - memory[THETA_1, i]) / PERIOD
            known = (theta[i] - 2.0 * memory[THETA_1, i] + memory[THETA_2, i]) / (PERIOD * PERIOD)
            memory[THETA_2, i] = memory[THETA_1, i]
            memory[THETA_1, i] = theta[i]
        u = (
            tau_delta[i]
            - role[SENSED, i] * (tau_h[i] - role[TARE, i])
            - role[DAMPING, i] * velocity
            - role[STIFFNESS, i] * (angle - goal)
        ) / role[INERTIA, i]
        memory[IDEAL_VELOCITY, i] += PERIOD * u
        command[i] = u + gamma * (memory[IDEAL_VELOCITY, i] - velocity) - known
    for i in range(n):
        total = tau_h[i] - role[TARE, i] if observer else memory[COMMAND, i]
        for j in range(n):
            total += model[INERTIA_MODEL, i, j] * command[j]
        memory[COMMAND, i] = total
    for i in range(n):
        command[i] = memory[COMMAND, i]


@compiled
def forgo(arrays: LawArrays) -> None:
    """Subtract from the ideal velocity what a clipped command can't bring about (anti-windup).

    Otherwise it would grow without limit while commands are clipped, and throw the joint about once
    they no longer are. With the subtraction it approaches the observed velocity, at the rate Γ. The
    command is what will be sent; COMMAND of the memory still holds what the law asked for.
    """
    command, model, memory = arrays.command, arrays.model, arrays.memory
    n = command.size
    for i in range(n):
        for j in range(n):
            missing = command[j] - memory[COMMAND, j]
            memory[IDEAL_VELOCITY, i] += PERIOD * model[INVERSE, i, j] * missing
