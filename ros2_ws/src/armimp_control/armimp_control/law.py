"""Whichever law is chosen, as the node and the offline loop use it, with the one safety gate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled_entry
from armimp_control.imbic import ImbicConfig, imbic
from armimp_control.layout import COMMAND, MEMORY_ROWS
from armimp_control.pd import PdConfig, pd
from armimp_control.safety import REFUSED, limit_torque

LawConfig: TypeAlias = ImbicConfig | PdConfig

# What tells the laws apart in compiled code.
_IMBIC, _PD = 0, 1


@dataclass(frozen=True, kw_only=True, eq=False)
class LawNumbers:
    """What compiled code has to know of a law, beside the roles of the joints.

    Attributes
    ----------
    law : number of the law
    target : (n,) θ_rd, rad
    model : (n, n) M̄, kg·m²; zero for a law without internal model
    gamma : Γ, rad/s; likewise
    period : L, s
    """

    law: int
    target: NDArray[np.float64]
    model: NDArray[np.float64]
    gamma: float
    period: float

    @classmethod
    def of(cls, config: LawConfig) -> LawNumbers:
        """Numbers of a configuration."""
        if isinstance(config, PdConfig):
            law, model, gamma = _PD, np.zeros((config.joints, config.joints)), 0.0
        else:
            law, model, gamma = _IMBIC, config.model_inertia, config.gamma
        return cls(
            law=law,
            target=config.target_posture,
            model=model,
            gamma=gamma,
            period=config.period,
        )


@compiled_entry
def control_tick(  # noqa: PLR0913, PLR0917 (compiled code takes no objects)
    law: int,
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
    """One tick of a law, and the safety gate after it.

    Parameters
    ----------
    law : number of the law, see :class:`LawNumbers`
    theta, tau_h, tau_delta : (n,) rad, N·m, N·m: encoders, torque transducers, perturbation
    role : (4, n) from the configuration of the law
    target, model, gamma, period : see :class:`LawNumbers`
    torque_limit : N·m
    memory : (MEMORY_ROWS, n), updated; zeros before the first tick
    command : (n,) N·m, written

    Returns
    -------
    int
        Number of saturated joints; :data:`armimp_control.safety.REFUSED` if the result is not
        finite: the command is then zero and the memory starts anew.
    """
    if law == _PD:
        pd(theta, tau_delta, role, target, period, memory, command)
    else:
        imbic(theta, tau_h, tau_delta, role, target, model, gamma, period, memory, command)
    clipped = limit_torque(command, torque_limit)
    if clipped == REFUSED:
        memory[:] = 0.0
    else:
        memory[COMMAND] = command
    return clipped


class Controller:
    """A law with its memory, for use tick by tick.

    Arrays given back are reused; copy what must last.

    Parameters
    ----------
    config : ImbicConfig or PdConfig
    torque_limit : N·m
    """

    def __init__(self, config: LawConfig, *, torque_limit: float) -> None:
        self.config = config
        self.torque_limit = torque_limit
        self.memory = np.zeros((MEMORY_ROWS, config.joints))
        self.command = np.zeros(config.joints)
        self.role = config.role(0)
        self._numbers = LawNumbers.of(config)

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
        """Compute :attr:`command` from a sample; parameters and result as of :func:`control_tick`.

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
        numbers = self._numbers
        return control_tick(
            numbers.law,
            theta,
            tau_h,
            tau_delta,
            self.role,
            numbers.target,
            numbers.model,
            numbers.gamma,
            numbers.period,
            self.torque_limit,
            self.memory,
            self.command,
        )
