"""IMBIC: internal-model-based impedance control by time-delay estimation and ideal velocity.

The law (eq. 4–8 of the paper), once per tick k of length L::

    u    = M_rd⁻¹ [τ_Δ − τ_h' − B_rd θ̇ − K_rd (θ − θ_rd)]         desired acceleration
    v_id = ∫ u dt                                                ideal velocity
    τ_t  = τ_{t−L} + M̄ [u + Γ (v_id − θ̇) − θ̈_{t−L}]

with θ̇ = (θ_k − θ_{k−1})/L and θ̈_{t−L} = (θ_k − 2θ_{k−1} + θ_{k−2})/L². On the perturbed joint τ_h'
is the measured torque on the arm; on locked joints τ_h' = 0 and τ_Δ = 0 and the target is stiff,
so that they hold still whatever the arm does. τ_{t−L} is the command actually sent, after
saturation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled
from armimp_common.errors import ConfigurationError
from armimp_control.layout import (
    COMMAND,
    DAMPING,
    IDEAL_VELOCITY,
    INERTIA,
    ROLE_ROWS,
    SENSED,
    STARTED,
    STIFFNESS,
    THETA_1,
    THETA_2,
)


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

    def __post_init__(self) -> None:
        n = self.target_posture.size
        for name in ("target_posture", "target_inertia", "target_damping", "target_stiffness"):
            values = getattr(self, name)
            if values.shape != (n,) or not np.all(np.isfinite(values)):
                raise ConfigurationError(
                    f"controller: {name} needs {n} finite values: {values.tolist()}"
                )
        if self.model_inertia.shape != (n, n) or not np.all(np.isfinite(self.model_inertia)):
            raise ConfigurationError(
                f"controller: model_inertia needs {n}×{n} finite values: "
                f"{self.model_inertia.tolist()}"
            )
        for i, value in enumerate(self.target_inertia):
            if not value > 0.0:
                raise ConfigurationError(
                    f"controller: target_inertia of joint {i + 1} must be positive, got {value}"
                )
        for name in ("lock_frequency", "lock_damping_ratio", "gamma", "period"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"controller: {name} must be positive, got {getattr(self, name)}"
                )

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return self.target_posture.size

    def role(self, perturbed: int | None) -> NDArray[np.float64]:
        """Law parameters (4, n) while joint ``perturbed`` (0-based) yields and the others lock.

        With None all joints yield. Rows: share of τ_h' sensed (1 or 0), M_rd (kg·m²), B_rd
        (N·m·s/rad), K_rd (N·m/rad).
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
    """One tick of the law, before the safety gate.

    Parameters
    ----------
    theta, tau_h, tau_delta : (n,) rad, N·m, N·m: encoders, torque transducers, perturbation
    role : (4, n) from :meth:`ImbicConfig.role`
    target : (n,) θ_rd, rad
    model : (n, n) M̄, kg·m²
    gamma, period : rad/s, s
    memory : (MEMORY_ROWS, n), updated; zeros before the first tick; COMMAND holds what was sent
    command : (n,) N·m, written
    """
    n = theta.size
    if memory[STARTED, 0] == 0.0:
        for i in range(n):
            memory[THETA_1, i] = memory[THETA_2, i] = theta[i]
        memory[STARTED, 0] = 1.0
    for i in range(n):
        velocity = (theta[i] - memory[THETA_1, i]) / period
        u = (
            tau_delta[i]
            - role[SENSED, i] * tau_h[i]
            - role[DAMPING, i] * velocity
            - role[STIFFNESS, i] * (theta[i] - target[i])
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
    command[:] = memory[COMMAND]
