"""What is known of the rig between command and reading: late commands, slow drives, late τ_h."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError

FloatArray = NDArray[np.float64]
_RANGES = {"actuator_lag": (1e-9, 1.0, "s"), "torque_cutoff": (1e-3, 1e9, "Hz")}
"""Beyond these nothing can be computed any more, and no rig is."""


@dataclass(frozen=True, kw_only=True)
class RigDynamics:
    """For the stability check; all joints alike.

    Parameters
    ----------
    command_delay : periods by which a command acts later than the one after the sample it answers
    actuator_lag : time constant with which the torque of the drives follows commands, s; 0: at once
    torque_delay : of the readings of torque, s
    torque_cutoff : of the Butterworth low-pass before they are sampled, Hz; 0: there is none
    torque_order : of that low-pass

    Raises
    ------
    ConfigurationError
        If a value is out of range.
    """

    command_delay: int = 0
    actuator_lag: float = 0.0
    torque_delay: float = 0.0
    torque_cutoff: float = 0.0
    torque_order: int = 1

    def __post_init__(self) -> None:
        for name in ("actuator_lag", "torque_delay", "torque_cutoff"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"known: {name} must be finite and not negative, got {getattr(self, name)}"
                )
        for name, (least, most, unit) in _RANGES.items():
            if getattr(self, name) and not least <= getattr(self, name) <= most:
                raise ConfigurationError(
                    f"known: {name} must be 0, or between {least:g} and {most:g} {unit}, "
                    f"got {getattr(self, name)}"
                )
        if self.command_delay < 0:
            raise ConfigurationError(
                f"known: command_delay must not be negative, got {self.command_delay}"
            )
        if self.torque_order < 1:
            raise ConfigurationError(f"known: torque_order must be 1, got {self.torque_order}")

    @property
    def none(self) -> bool:
        """Whether commands, drives and readings are prompt."""
        return self == RigDynamics(torque_order=self.torque_order)

    def sampled(self, period: float) -> SampledDynamics:
        """The same from tick to tick, for a command that is held over the period (s)."""
        a, b, reads = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
        lag, cutoff = self.actuator_lag, self.torque_cutoff
        if cutoff > 0.0:
            # Where there is no low-pass, nobody has to wait for this import.
            from scipy.signal import butter, zpk2ss

            zpk = butter(self.torque_order, 2.0 * np.pi * cutoff, analog=True, output="zpk")
            a, b, reads, _ = zpk2ss(*zpk)
        if lag > 0.0:
            # The drive comes first; its state is its torque.
            a = np.block([[-np.eye(1) / lag, np.zeros((1, len(a)))], [b, a]])
            reads = np.concatenate([np.zeros((1, 1)), reads], axis=1) if cutoff > 0.0 else np.eye(1)
            b = np.zeros((len(a), 1))
            b[0] = 1.0 / lag
        whole = int(np.floor(self.torque_delay / period + 1e-9))
        phase = 1.0 - min(max(self.torque_delay / period - whole, 0.0), 1.0)
        transition, from_command = _over(a, b, period)
        part, part_command = _over(a, b, phase * period)
        if len(reads[0]):
            from_state, direct = (reads @ part)[0], float((reads @ part_command)[0, 0])
        else:
            from_state, direct = np.zeros(0), 1.0
        return SampledDynamics(
            transition=transition,
            from_command=from_command[:, 0],
            reading_from_state=from_state,
            reading_from_command=direct,
            delay=whole,
            drive_lags=lag > 0.0,
            **_moved_by(lag, period),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledDynamics:
    """From tick to tick, for a command u: states x of drive and low-pass, and what is read.

    Attributes
    ----------
    transition, from_command : (q, q), (q,) of ``x ← transition · x + from_command · u``
    reading_from_state, reading_from_command : (q,) and one number
        Of the reading, as torque of the drive, from x before and u during the last period.
    delay : ticks that it comes later
    drive_lags : whether the first state is the torque of the drive
    speed, way : what velocity (s) and angle (s²) gain per unit of torque / inertia of the drive at
        the start of a period, and of the command in it
    """

    transition: FloatArray
    from_command: FloatArray
    reading_from_state: FloatArray
    reading_from_command: float
    delay: int
    drive_lags: bool
    speed: tuple[float, float]
    way: tuple[float, float]

    @property
    def states(self) -> int:
        """Number q of the states of drive and low-pass."""
        return len(self.transition)


def _over(a: FloatArray, b: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
    """Transition of a linear system over a time (s) with constant input."""
    q = len(a)
    if not q:
        return a, b
    from scipy.linalg import expm

    system = np.zeros((q + 1, q + 1))
    system[:q, :q], system[:q, q:] = a * time, b * time
    over = expm(system)
    return over[:q, :q], over[:q, q:]


def _moved_by(lag: float, period: float) -> dict[str, tuple[float, float]]:
    if lag == 0.0:
        return {"speed": (0.0, period), "way": (0.0, 0.5 * period**2)}
    left = -lag * np.expm1(-period / lag)
    way = lag * (period - left)
    return {"speed": (left, period - left), "way": (way, 0.5 * period**2 - way)}
