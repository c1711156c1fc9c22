"""Whichever law is chosen, as the node and the offline loop use it, with the one safety gate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled_entry
from armimp_control.faults import clip_counts, in_words
from armimp_control.gate import (
    CLOSED,
    FAULT,
    GATE_ROWS,
    JOURNAL,
    PRESENT,
    RATE,
    SENT,
    close_gate,
    examine,
    fall,
    let_through,
)
from armimp_control.imbic import ImbicConfig, imbic
from armimp_control.layout import COMMAND, MEMORY_ROWS, NO_JOINT, TARE
from armimp_control.pd import PdConfig, pd
from armimp_control.safety import Limit, SafetyConfig

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
    rules: NDArray[np.float64],
    memory: NDArray[np.float64],
    gate: NDArray[np.float64],
    journal: NDArray[np.float64],
    command: NDArray[np.float64],
) -> int:
    """One tick of a law, with the safety gate before and after it.

    Parameters
    ----------
    law : number of the law, see :class:`LawNumbers`
    theta, tau_h, tau_delta : (n,) rad, N·m, N·m: encoders, torque transducers, perturbation
    role : (8, n) from the configuration of the law
    target, model, gamma, period : see :class:`LawNumbers`
    rules : (RULE_ROWS, n) from :meth:`armimp_control.safety.SafetyConfig.rules`
    memory : (MEMORY_ROWS, n), updated; zeros before the first tick
    gate, journal : (GATE_ROWS, n) and (JOURNAL,) of :mod:`armimp_control.gate`, likewise
    command : (n,) N·m, written

    Returns
    -------
    int
        Number of joints whose command was clipped. After a stop, which the journal tells, the law
        is not computed any more and its memory is empty.
    """
    if examine(theta, tau_h, tau_delta, rules, period, gate, journal):
        if law == _PD:
            pd(theta, tau_delta, role, target, period, memory, command)
        else:
            imbic(theta, tau_h, tau_delta, role, target, model, gamma, period, memory, command)
    clipped = let_through(command, rules, gate, journal)
    if journal[CLOSED] != 0.0:
        memory[:] = 0.0
    else:
        memory[COMMAND] = command
    return clipped


class Controller:
    """A law and its safety gate with their memory, for use tick by tick.

    Arrays given back are reused; copy what must last. A gate that has closed stays closed.

    Parameters
    ----------
    config : ImbicConfig or PdConfig
    safety : SafetyConfig

    Raises
    ------
    ConfigurationError
        If the limits do not fit the joints.
    """

    def __init__(self, config: LawConfig, *, safety: SafetyConfig) -> None:
        self.config = config
        self.rules = safety.rules(config.target_posture, config.period)
        self.memory = np.zeros((MEMORY_ROWS, config.joints))
        self.command = np.zeros(config.joints)
        self.role = config.role(0)
        self._tare = np.zeros(config.joints)
        self._gate = np.zeros((GATE_ROWS, config.joints))
        self._journal = np.zeros(JOURNAL)
        self._ramp_ticks = safety.ramp_ticks(config.period)
        self._numbers = numbers = LawNumbers.of(config)
        self._rest = (
            numbers.target,
            numbers.model,
            numbers.gamma,
            numbers.period,
            self.rules,
            self.memory,
            self._gate,
            self._journal,
            self.command,
        )
        self._notes = self._journal.data  # read in half the time

    @property
    def closed(self) -> bool:
        """Whether commands pass no more: the torque is zero, or on its way there."""
        return self._notes[CLOSED] != 0.0

    @property
    def fault(self) -> str:
        """Why the gate has closed by itself, in words; else empty."""
        return in_words(self._journal, FAULT, self.rules)

    @property
    def present_fault(self) -> str:
        """What is wrong with the last sample, whether or not the gate is closed; else empty."""
        return in_words(self._journal, PRESENT, self.rules)

    @property
    def clips(self) -> dict[Limit, int]:
        """Number of clipped joint commands for each limit."""
        return clip_counts(self._journal)

    def perturb_joint(self, joint: int) -> None:
        """Make ``joint`` (0-based) the compliant one and lock the others, without a jump."""
        self.role = self.config.role(joint)
        self.role[TARE] = self._tare

    def lock(self) -> None:
        """Hold all joints, without a jump."""
        self.perturb_joint(NO_JOINT)

    def tare(self, offset: Sequence[float]) -> None:
        """From now on take what torque transducers read at rest (n,), N·m, from their readings.

        Only what a law makes of them changes; the gate looks at the readings themselves.
        """
        self._tare[:] = offset
        self.role[TARE] = self._tare

    def reset(self) -> None:
        """Forget the past: the next tick starts from rest with zero torque and an open gate."""
        for memory in (self.memory, self._gate, self._journal, self.command):
            memory.fill(0.0)

    def stop(self) -> None:
        """Close the gate for a fault that the caller knows; the torque ramps down to zero."""
        close_gate(self._ramp_ticks, True, self._gate, self._journal)

    def cut(self) -> None:
        """Close the gate for a fault that the caller knows; zero torque at once."""
        close_gate(0, True, self._gate, self._journal)
        self.command[:] = 0.0

    def release(self) -> None:
        """Close the gate at the end, without a fault: to zero as fast as the rate limit allows."""
        ticks = np.ceil(np.max(np.abs(self._gate[SENT]) / self.rules[RATE]))
        close_gate(max(int(ticks), 1), False, self._gate, self._journal)

    def fall(self, ticks: int) -> None:
        """Go on with the ramp of a closed gate by some ticks, where no samples come."""
        fall(ticks, self.command, self.rules, self._gate, self._journal)

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
        self._check_shapes(theta, tau_h, tau_delta)
        return control_tick(self._numbers.law, theta, tau_h, tau_delta, self.role, *self._rest)

    def ticker(
        self,
        theta: NDArray[np.float64],
        tau_h: NDArray[np.float64],
        tau_delta: NDArray[np.float64],
    ) -> Callable[[], int]:
        """:meth:`tick` for arrays that are filled anew before each call.

        Raises
        ------
        ValueError
            As of :meth:`tick`, but only here.
        """
        self._check_shapes(theta, tau_h, tau_delta)
        law, rest = self._numbers.law, self._rest

        def tick() -> int:
            return control_tick(law, theta, tau_h, tau_delta, self.role, *rest)

        return tick

    def _check_shapes(
        self,
        theta: NDArray[np.float64],
        tau_h: NDArray[np.float64],
        tau_delta: NDArray[np.float64],
    ) -> None:
        if not theta.shape == tau_h.shape == tau_delta.shape == self.command.shape:
            raise ValueError(
                f"controller: theta {theta.shape}, tau_h {tau_h.shape} and tau_delta "
                f"{tau_delta.shape} must all be {self.command.shape}"
            )
