"""Whichever law is chosen, as the node and the offline loop use it, with the one safety gate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled, compiled_entry
from armimp_control.faults import clip_counts, in_words
from armimp_control.laws.imbic import ImbicConfig, imbic
from armimp_control.laws.layout import COMMAND, MEMORY_ROWS, NO_JOINT, ROLE_ROWS, TARE
from armimp_control.laws.pd import PdConfig, pd
from armimp_control.safety import Limit, SafetyConfig
from armimp_control.safety_limiter import (
    CLOSED,
    FAULT,
    GATE_ROWS,
    JOURNAL,
    PRESENT,
    RATE,
    RULE_ROWS,
    SENT,
    close_gate,
    examine,
    fall,
    let_through,
)

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
    gate, journal : (GATE_ROWS, n) and (JOURNAL,) of :mod:`armimp_control.safety_limiter`, likewise
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


Arrays: TypeAlias = NDArray[np.float64]


def _unpacked(
    w: Arrays, n: int
) -> tuple[Arrays, Arrays, Arrays, Arrays, Arrays, Arrays, Arrays, Arrays, Arrays]:
    """Views of what a controller of n joints works on, all of it in one array.

    Returns
    -------
    sample : (3, n) θ, τ_h, τ_Δ
    posture : (2, n) command and target
    role, rules, memory, gate, model, journal : as for :func:`control_tick`
    scalars : (2,) Γ and L
    """
    a = 3 * n
    b = a + 2 * n
    c = b + ROLE_ROWS * n
    d = c + RULE_ROWS * n
    e = d + MEMORY_ROWS * n
    f = e + GATE_ROWS * n
    g = f + n * n
    h = g + JOURNAL
    return (
        w[:a].reshape((3, n)),
        w[a:b].reshape((2, n)),
        w[b:c].reshape((ROLE_ROWS, n)),
        w[c:d].reshape((RULE_ROWS, n)),
        w[d:e].reshape((MEMORY_ROWS, n)),
        w[e:f].reshape((GATE_ROWS, n)),
        w[f:g].reshape((n, n)),
        w[g:h],
        w[h:],
    )


def _packed(n: int) -> Arrays:
    """Zeros for :func:`_unpacked`."""
    rows = 5 + ROLE_ROWS + RULE_ROWS + MEMORY_ROWS + GATE_ROWS + n
    return np.zeros(rows * n + JOURNAL + 2)


_views = compiled(_unpacked)


@compiled_entry
def _packed_tick(law: int, n: int, w: Arrays) -> int:
    """:func:`control_tick` of one array: each one that is passed takes as long as the law."""
    sample, posture, role, rules, memory, gate, model, journal, scalars = _views(w, n)
    return control_tick(
        law,
        sample[0],
        sample[1],
        sample[2],
        role,
        posture[1],
        model,
        scalars[0],
        scalars[1],
        rules,
        memory,
        gate,
        journal,
        posture[0],
    )


class Controller:
    """A law and its safety gate with their memory, for use tick by tick.

    Arrays given back are reused; copy what must last. A gate that has closed stays closed.

    Parameters
    ----------
    config : ImbicConfig or PdConfig
    safety : SafetyConfig

    Attributes
    ----------
    sample : (3, n) θ (rad), τ_h and τ_Δ (N·m) of the present tick
    command : (n,) answer to it, N·m

    Raises
    ------
    ConfigurationError
        If the limits do not fit the joints.
    """

    def __init__(self, config: LawConfig, *, safety: SafetyConfig) -> None:
        self.config = config
        n, numbers = config.joints, LawNumbers.of(config)
        self._law, self._joints, self._all = numbers.law, n, _packed(n)
        views = _unpacked(self._all, n)
        self.sample, posture, self.role, self.rules, self.memory, self._gate = views[:6]
        model, self._journal, scalars = views[6:]
        self.command = posture[0]
        posture[1], model[:], scalars[:] = (
            numbers.target,
            numbers.model,
            (numbers.gamma, numbers.period),
        )
        self.rules[:] = safety.rules(config.target_posture, config.period)
        self._tare = np.zeros(n)
        self.perturb_joint(0)
        self._ramp_ticks = safety.ramp_ticks(config.period)
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
        self.role[:] = self.config.role(joint)
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
        if not theta.shape == tau_h.shape == tau_delta.shape == self.command.shape:
            raise ValueError(
                f"controller: theta {theta.shape}, tau_h {tau_h.shape} and tau_delta "
                f"{tau_delta.shape} must all be {self.command.shape}"
            )
        self.sample[:] = theta, tau_h, tau_delta
        return self.compute()

    def compute(self) -> int:
        """:meth:`tick` of what was written into :attr:`sample`."""
        return _packed_tick(self._law, self._joints, self._all)
