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

from armimp_common.compiled import compiled_entry
from armimp_common.errors import ConfigurationError
from armimp_control.safety import REFUSED, limit_torque

# Rows of the memory between ticks.
_THETA_1, _THETA_2, _IDEAL_VELOCITY, _COMMAND, _STARTED = range(5)
MEMORY_ROWS = 5
# Rows of the role parameters.
_SENSED, _INERTIA, _DAMPING, _STIFFNESS = range(4)


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

    def role(self, perturbed: int) -> NDArray[np.float64]:
        """Law parameters (4, n) while joint ``perturbed`` (0-based) yields and the others lock.

        Rows: share of τ_h' sensed (1 or 0), M_rd (kg·m²), B_rd (N·m·s/rad), K_rd (N·m/rad).
        """
        locked = np.arange(self.joints) != perturbed
        rows = np.empty((4, self.joints))
        rows[_SENSED] = ~locked
        rows[_INERTIA] = self.target_inertia
        rows[_DAMPING] = np.where(
            locked,
            2.0 * self.lock_damping_ratio * self.lock_frequency * self.target_inertia,
            self.target_damping,
        )
        rows[_STIFFNESS] = np.where(
            locked, self.lock_frequency**2 * self.target_inertia, self.target_stiffness
        )
        return rows


@compiled_entry
def imbic(  # noqa: PLR0913, PLR0917 (compiled code takes no objects)
    theta: NDArray[np.float64],
    tau_h: NDArray[np.float64],
    tau_delta: NDArray[np.float64],
    role: NDArray[np.float64],
    target: NDArray[np.float64],
    model: NDArray[np.float64],
    gamma: float,
    period: float,
    torque_limit: float,
    memory: NDArray[np.float64],
    command: NDArray[np.float64],
) -> int:
    """One tick of the law.

    Parameters
    ----------
    theta, tau_h, tau_delta : (n,) rad, N·m, N·m: encoders, torque transducers, perturbation
    role : (4, n) from :meth:`ImbicConfig.role`
    target : (n,) θ_rd, rad
    model : (n, n) M̄, kg·m²
    gamma, period, torque_limit : rad/s, s, N·m
    memory : (MEMORY_ROWS, n), updated; zeros before the first tick
    command : (n,) N·m, written

    Returns
    -------
    int
        Number of saturated joints; :data:`armimp_control.safety.REFUSED` if the result or an input
        is not finite: the command is then zero and the memory starts anew.
    """
    n = theta.size
    if memory[_STARTED, 0] == 0.0:
        for i in range(n):
            memory[_THETA_1, i] = memory[_THETA_2, i] = theta[i]
        memory[_STARTED, 0] = 1.0
    for i in range(n):
        velocity = (theta[i] - memory[_THETA_1, i]) / period
        u = (
            tau_delta[i]
            - role[_SENSED, i] * tau_h[i]
            - role[_DAMPING, i] * velocity
            - role[_STIFFNESS, i] * (theta[i] - target[i])
        ) / role[_INERTIA, i]
        memory[_IDEAL_VELOCITY, i] += period * u
        acceleration = (theta[i] - 2.0 * memory[_THETA_1, i] + memory[_THETA_2, i]) / (
            period * period
        )
        memory[_THETA_2, i] = memory[_THETA_1, i]
        memory[_THETA_1, i] = theta[i]
        command[i] = u + gamma * (memory[_IDEAL_VELOCITY, i] - velocity) - acceleration
    for i in range(n):
        total = memory[_COMMAND, i]
        for j in range(n):
            total += model[i, j] * command[j]
        memory[_COMMAND, i] = total
    command[:] = memory[_COMMAND]
    clipped = limit_torque(command, torque_limit)
    if clipped == REFUSED:
        memory[:] = 0.0
    else:
        memory[_COMMAND] = command
    return clipped


class ImbicController:
    """The law with its memory, for use tick by tick.

    Arrays given back are reused; copy what must last.

    Parameters
    ----------
    config : ImbicConfig
    torque_limit : N·m
    """

    def __init__(self, config: ImbicConfig, *, torque_limit: float) -> None:
        self.config = config
        self.torque_limit = torque_limit
        self.memory = np.zeros((MEMORY_ROWS, config.joints))
        self.command = np.zeros(config.joints)
        self.role = config.role(0)

    def perturb_joint(self, joint: int) -> None:
        """Make ``joint`` (0-based) the compliant one and lock the others, without a jump."""
        self.role = self.config.role(joint)

    def reset(self) -> None:
        """Forget the past: the next tick starts from rest with zero torque."""
        self.memory[:] = 0.0

    def tick(
        self,
        theta: NDArray[np.float64],
        tau_h: NDArray[np.float64],
        tau_delta: NDArray[np.float64],
    ) -> int:
        """Compute :attr:`command` from one sample; parameters and result as of :func:`imbic`.

        Raises
        ------
        ValueError
            If an input has another shape; compiled code would read beyond its end.
        """
        if not theta.shape == tau_h.shape == tau_delta.shape == self.command.shape:
            raise ValueError(
                f"controller: theta {theta.shape}, tau_h {tau_h.shape} and tau_delta "
                f"{tau_delta.shape} must all be {self.command.shape}"
            )
        return imbic(
            theta,
            tau_h,
            tau_delta,
            self.role,
            self.config.target_posture,
            self.config.model_inertia,
            self.config.gamma,
            self.config.period,
            self.torque_limit,
            self.memory,
            self.command,
        )
