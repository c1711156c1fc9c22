"""One tick of the chosen law, between the two steps of the safety limiter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled, compiled_entry
from armimp_common.status import Cause
from armimp_control.laws import (
    COMMAND,
    IMBIC_OBSERVER,
    MEMORY_ROWS,
    MODEL_ROWS,
    NO_JOINT,
    PD,
    ROLE_ROWS,
    TARE,
    Law,
    LawArrays,
)
from armimp_control.laws.imbic import Imbic, forgo, imbic
from armimp_control.laws.pd import Pd, pd
from armimp_control.safety_limiter import (
    CLIPPED,
    COMMAND_LIMITS,
    FAULT,
    JOURNAL,
    LIMITER_ROWS,
    PRESENT,
    RATE,
    RULE_ROWS,
    SENT,
    STOPPED,
    TORQUE,
    Limiter,
    SafetyParameters,
    check_sample,
    continue_ramp,
    copy_values,
    fault_of,
    limit_command,
    stop_commands,
)

LAWS: Final[Mapping[str, type[Law]]] = {"imbic": Imbic, "pd": Pd}
"""The laws by the parameter ``law.kind``."""


@compiled
def _unpacked(w: FloatArray, n: int) -> tuple[LawArrays, Limiter]:
    """Return the parts of the array `w` on which a controller works."""
    a = 4 * n
    b = a + ROLE_ROWS * n
    c = b + MEMORY_ROWS * n
    d = c + MODEL_ROWS * n * n
    e = d + RULE_ROWS * n
    f = e + LIMITER_ROWS * n
    law = LawArrays(
        w[: 3 * n].reshape((3, n)),
        w[3 * n : a],
        w[a:b].reshape((ROLE_ROWS, n)),
        w[b:c].reshape((MEMORY_ROWS, n)),
        w[c:d].reshape((MODEL_ROWS, n, n)),
    )
    return law, Limiter(w[d:e].reshape((RULE_ROWS, n)), w[e:f].reshape((LIMITER_ROWS, n)), w[f:])


def packed_size(n: int) -> int:
    """Return the length of the array on which a controller of n joints works."""
    rows = 4 + ROLE_ROWS + RULE_ROWS + MEMORY_ROWS + LIMITER_ROWS + MODEL_ROWS * n
    return rows * n + JOURNAL


@compiled
def packed_tick(law: int, n: int, w: FloatArray) -> int:
    """Compute one tick of a law, with the safety limiter before and after it.

    Parameters
    ----------
    law : `kind` of the law
    n : number of joints
    w : (packed_size(n),) array on which a controller works, see :func:`_unpacked`; the sample comes
        first: θ (rad), τ_h and τ_Δ (N·m), then the command, which is written (N·m)

    Returns
    -------
    int
        Number of joints whose command was clipped. After a stop, which the journal records, the law
        is no longer computed and its memory is zero.
    """
    arrays, limiter = _unpacked(w, n)
    if check_sample(arrays.sample, limiter):
        if law == PD:
            pd(arrays)
        else:
            imbic(law == IMBIC_OBSERVER, arrays)
    clipped = limit_command(arrays.command, limiter)
    if limiter.journal[STOPPED] != 0.0:
        arrays.memory[:] = 0.0
    else:
        if law == IMBIC_OBSERVER and clipped > 0:
            forgo(arrays)
        copy_values(arrays.command, arrays.memory[COMMAND])
    return clipped


# For calls from Python: one array, as passing its parts one by one takes as long as the law.
_tick = compiled_entry(packed_tick)


class Controller:
    """A law and its safety limiter with their memory, for use tick by tick.

    Returned arrays are reused; copy what must last. A limiter that has stopped stays stopped.

    Parameters
    ----------
    law : one of :data:`LAWS`
    safety : limits
    storage : (packed_size(n),) zeros to work on; by default a new array

    Attributes
    ----------
    sample : (3, n) θ (rad), τ_h and τ_Δ (N·m) of the present tick
    command : (n,) answer to it, N·m

    Raises
    ------
    ConfigurationError
        If the limits do not fit the joints.
    """

    def __init__(
        self, law: Law, *, safety: SafetyParameters, storage: FloatArray | None = None
    ) -> None:
        self.law = law
        n = law.joints
        self._kind, self._joints = law.kind, n
        self._all = np.zeros(packed_size(n)) if storage is None else storage
        self._arrays, self._limiter = _unpacked(self._all, n)
        self.sample, self.command = self._arrays.sample, self._arrays.command
        self._limiter.rules[:] = safety.rules(law.target_posture)
        self._tare = np.zeros(n)
        # Models are computed and kept now, as there is no time for that between two samples.
        for joint in (NO_JOINT, *range(n)):
            law.model(joint)
        self.perturb_joint(0)
        self._ramp_ticks = safety.ramp_ticks
        self._notes = self._limiter.journal.data  # a memoryview, read in half the time

    @property
    def stopped(self) -> bool:
        """Whether the torque is zero, or ramping down to it, for good."""
        return self._notes[STOPPED] != 0.0

    @property
    def fault(self) -> tuple[Cause, str]:
        """Why the limiter has stopped by itself, as a code and in words; else NONE and empty."""
        return fault_of(self._limiter, FAULT)

    @property
    def present_fault(self) -> str:
        """What is wrong with the last sample, stopped or not; else empty."""
        return fault_of(self._limiter, PRESENT)[1]

    @property
    def clipped(self) -> dict[str, int]:
        """Number of clipped joint commands for each limit of commands."""
        counts = enumerate(COMMAND_LIMITS, TORQUE)
        return {limit: int(self._notes[CLIPPED + i]) for i, limit in counts}

    def perturb_joint(self, joint: int | None) -> None:
        """Make ``joint`` (0-based; None: all) compliant and lock the others, without a jump.

        With NO_JOINT all joints are locked.
        """
        self._arrays.role[:] = self.law.role(joint)
        self._arrays.role[TARE] = self._tare
        self._arrays.model[:] = self.law.model(joint)

    def tare(self, offset: Sequence[float]) -> None:
        """Subtract what torque transducers read at rest (n,), N·m, from their readings from now on.

        Only the law uses the difference; the limiter checks the readings themselves.
        """
        self._tare[:] = offset
        self._arrays.role[TARE] = self._tare

    def stop(self) -> None:
        """Stop for a fault that the caller knows; the torque ramps down to zero."""
        stop_commands(self._ramp_ticks, self._limiter)

    def cut(self) -> None:
        """Stop for a fault that the caller knows; zero torque at once."""
        stop_commands(0, self._limiter)
        self.command[:] = 0.0

    def release(self) -> None:
        """Stop at the end, without a fault: torque falls as fast as the rate limit allows."""
        ticks = np.ceil(np.max(np.abs(self._limiter.memory[SENT]) / self._limiter.rules[RATE]))
        stop_commands(max(int(ticks), 1), self._limiter)

    def continue_ramp(self, ticks: int) -> None:
        """Advance the ramp after a stop by some ticks, while no samples come."""
        continue_ramp(ticks, self.command, self._limiter)

    def compute(self) -> int:
        """Compute :attr:`command` from :attr:`sample`; the result is that of `packed_tick`."""
        return _tick(self._kind, self._joints, self._all)


def compile_law(law: Law, safety: SafetyParameters) -> None:
    """Compile what a controller calls in each tick, before time matters."""
    Controller(law, safety=safety).compute()
