"""What is known of the rig beforehand: inertia, arm, and delays of commands and torques."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field, model_validator

from armimp_common.arrays import FloatArray
from armimp_common.schema import PositiveVector, Schema, Vector
from armimp_common.topics import PERIOD

MOST_DELAY = 20
"""Largest delay of commands that can be declared to the controller (control periods)."""


class RigDynamics(Schema):
    """Delays and lags between a command and the torque reading, the same for all joints."""

    command_delay: int = Field(default=0, ge=0, le=MOST_DELAY)
    """Control periods by which commands act late, counted from just after the sample they answer;
    the observer and the stability check take it into account."""
    actuator_lag: float = Field(default=0.0, ge=0.0, le=0.1)
    """Time constant with which the torque of the drives follows commands (s); 0 for at once."""
    torque_delay: float = Field(default=0.0, ge=0.0, le=0.1)
    """Delay of the readings of torque (s)."""
    torque_cutoff: float = Field(default=0.0, ge=0.0, le=1e9)
    """Cut-off frequency of the anti-alias low-pass of the torque (Hz); 0 for none."""
    torque_order: int = Field(default=1, ge=1, le=4)
    """Order of the Butterworth low-pass of the torque."""

    @model_validator(mode="after")
    def _computable(self) -> RigDynamics:
        for name, least in (("actuator_lag", 1e-9), ("torque_cutoff", 1e-3)):
            if 0.0 < getattr(self, name) < least:
                raise ValueError(f"{name} must be 0 or at least {least:g}")
        return self

    @property
    def prompt(self) -> bool:
        """Whether commands act, and torques are read, at once."""
        return not (
            self.command_delay or self.actuator_lag or self.torque_delay or self.torque_cutoff
        )

    def __str__(self) -> str:
        """Describe the dynamics in words, for an error that they may explain."""
        return (
            f"commands that act {self.command_delay} periods late, torques read "
            f"{1e3 * self.torque_delay:g} ms late, a low-pass at {self.torque_cutoff:g} Hz "
            f"(0: none) and drives that lag by {1e3 * self.actuator_lag:g} ms"
        )

    def sampled(self) -> SampledDynamics:
        """Return the dynamics from tick to tick, for a command that is held over the period."""
        # Imported here, as only the stability check and the observer need it.
        from scipy.linalg import expm

        poles, lags = self.torque_order if self.torque_cutoff else 0, int(self.actuator_lag > 0.0)
        size = 3 + lags + poles
        # The state: angle, velocity, drive torque if it lags, low-pass; then the held command.
        system, reads = np.zeros((size, size)), np.zeros(size)
        torque, low_pass = 2 if lags else -1, slice(2 + lags, 2 + lags + poles)
        system[0, 1] = system[1, torque] = 1.0
        if lags:
            system[2, [2, -1]] = -1.0 / self.actuator_lag, 1.0 / self.actuator_lag
        if poles:
            from scipy.signal import butter, zpk2ss

            a, b, c, _ = zpk2ss(*butter(poles, 1.0, analog=True, output="zpk"))
            speed = 2.0 * np.pi * self.torque_cutoff
            system[low_pass, low_pass], system[low_pass, torque] = speed * a, speed * b[:, 0]
            reads[low_pass] = c[0]
        else:
            reads[torque] = 1.0
        whole = int(np.floor(self.torque_delay / PERIOD + 1e-9))
        phase = 1.0 - min(max(self.torque_delay / PERIOD - whole, 0.0), 1.0)
        reading = reads @ expm(system * (phase * PERIOD))
        return SampledDynamics(expm(system * PERIOD)[:-1, 2:], reading[2:], whole)


class KnownParameters(RigDynamics):
    """What is known beforehand: for the stability check, gains of pd, and the perturbation."""

    robot_inertia: Vector
    """Inertia of the robot in the posture, M_r(θ_0), n×n row by row (kg·m²)."""
    arm_inertia: Vector
    """Expected inertia of the arm, M_h, n×n row by row (kg·m²)."""
    arm_frequency: PositiveVector = (8.0,)
    """Expected natural frequency of the arm, sqrt(K_kk/M_kk), for optimal perturbations and limits
    of the angle (rad/s); one value for all joints or one for each."""
    arm_damping_ratio: PositiveVector = (0.3,)
    """Expected damping ratio of the arm, B_kk/(2·sqrt(K_kk·M_kk)) (–); one value for all joints or
    one for each."""


class SampledDynamics(NamedTuple):
    """Dynamics of a joint from tick to tick: q states x of drive and low-pass, and a command u."""

    over: FloatArray
    """(2 + q, q + 1) from (x, u) to the angle (s²) and velocity (s) gained in a period, per unit of
    torque over inertia, and to the states after it."""
    reading: FloatArray
    """(q + 1,) from x before, and u during, the last period to the drive's torque as it is read."""
    delay: int
    """Whole ticks of further delay of the reading."""
