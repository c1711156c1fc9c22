"""Sampled stability of the law, checked before it is allowed to move anything."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from armimp_common.arrays import FloatArray
from armimp_common.errors import ConfigurationError
from armimp_common.schema import Schema
from armimp_control.laws import (
    ANGLE_GAIN,
    DAMPING,
    DISTURBANCE_GAIN,
    IMBIC_OBSERVER,
    INERTIA,
    INVERSE,
    LATE,
    MOST_DELAY,
    NO_JOINT,
    SENSED,
    STIFFNESS,
    VELOCITY_GAIN,
)
from armimp_control.laws.imbic import ImbicConfig
from armimp_control.laws.law import LawConfig

WARNING_GAIN = 1.25
"""Factor by which gains may become larger without a warning."""
ARM_RANGE = 3.0
"""Factor by which the arm may be heavier or lighter than known."""
_GROWTH = 1e-4
"""Growth per tick taken for rounding: a target without stiffness and damping has exactly none."""


class RigDynamics(Schema):
    """Between command and reading: late commands, slow drives, late torques; all joints alike."""

    command_delay: int = Field(default=0, ge=0, le=MOST_DELAY)
    """Control periods by which commands act later than right after the sample that they answer; the
    observer and the stability check take it into account."""
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
        """In words, for an error that they may be the reason of."""
        return (
            f"commands that act {self.command_delay} periods late, torques read "
            f"{1e3 * self.torque_delay:g} ms late, a low-pass at {self.torque_cutoff:g} Hz "
            f"(0: none) and drives that lag by {1e3 * self.actuator_lag:g} ms"
        )

    def sampled(self, period: float) -> SampledDynamics:
        """The same from tick to tick, for a command that is held over the period (s)."""
        # Only this check and the observer have to wait for the import.
        from scipy.linalg import expm

        poles, lags = self.torque_order if self.torque_cutoff else 0, int(self.actuator_lag > 0.0)
        size = 3 + lags + poles
        # Way, speed, torque of the drive if it lags, low-pass, and the command, which is held.
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
        whole = int(np.floor(self.torque_delay / period + 1e-9))
        phase = 1.0 - min(max(self.torque_delay / period - whole, 0.0), 1.0)
        reading = reads @ expm(system * (phase * period))
        return SampledDynamics(expm(system * period)[:-1, 2:], reading[2:], whole)


PROMPT: Final = RigDynamics()


class SampledDynamics(NamedTuple):
    """From tick to tick, for q states of drive and low-pass x and a command u, of each joint."""

    over: FloatArray
    """(2 + q, q + 1) what (x, u) make of a period: way (s²) and speed (s) per unit of torque /
    inertia, and the states after it."""
    reading: FloatArray
    """(q + 1,) torque of the drive as it is read, from x before and u during the last period."""
    delay: int
    """Ticks that it comes later."""


def check_stability(
    config: LawConfig,
    *,
    robot_inertia: FloatArray,
    arm_inertia: FloatArray,
    dynamics: RigDynamics = PROMPT,
) -> tuple[str, ...]:
    """Check the sampled loop with every joint perturbed in turn, and with all locked.

    The condition is that the loop of law and inertia returns to rest, see :func:`spectral_radius`,
    with the arm as it is known and one that is heavier or lighter by a factor of 3. Warnings tell
    of changes with which the loop would be unstable: larger gains, torques or commands one period
    later.

    Parameters
    ----------
    config : ImbicConfig or PdConfig
    robot_inertia : (n, n) M_r(θ_0), kg·m²
    arm_inertia : (n, n) M_h as far as it is known beforehand, kg·m²
    dynamics : of drives and transducers; by default they are prompt

    Returns
    -------
    tuple of str
        The warnings, a sentence each.

    Raises
    ------
    ConfigurationError
        If the loop is unstable or the inertia makes no sense; the message carries the value.
    """
    total = robot_inertia + arm_inertia
    smallest = float(np.linalg.eigvalsh(0.5 * (total + total.T))[0])
    if not smallest > 0.0:
        raise ConfigurationError(
            "controller: M_r + M_h must have a positive definite symmetric part, "
            f"its smallest eigenvalue is {smallest:.3g} kg·m²"
        )

    def radius_of(k: int, gain: float = 1.0, arm: float = 1.0, **changed: float) -> float:
        return spectral_radius(
            config,
            perturbed=k,
            robot_inertia=robot_inertia,
            arm_inertia=arm * arm_inertia,
            gain=gain,
            dynamics=dynamics.model_copy(update=changed),
        )

    roles = {k: f"joint {k + 1} is perturbed" for k in range(config.joints)}
    roles[NO_JOINT] = "all joints are locked"
    arms = {
        1.0: "",
        ARM_RANGE: f" with an arm {ARM_RANGE:g} times as heavy",
        1.0 / ARM_RANGE: f" with an arm {ARM_RANGE:g} times as light",
    }
    with_dynamics = "" if dynamics.prompt else f", with {dynamics}"
    for k, role in roles.items():
        for arm, described in arms.items():
            radius = radius_of(k, arm=arm)
            if not radius < 1.0 + _GROWTH:
                raise ConfigurationError(
                    f"controller: unstable when sampled: while {role}, motion grows by a factor of "
                    f"{radius:.4g} per tick{described}{with_dynamics}"
                )
    warnings = []
    gains = "M̄" if isinstance(config, ImbicConfig) else "gains"
    later = f"{1e3 * config.period:g} ms later"
    changes: dict[str, dict[str, Any]] = {
        f"{gains} larger by {WARNING_GAIN - 1.0:.0%}": {"gain": WARNING_GAIN},
        f"torques read {later}": {"torque_delay": dynamics.torque_delay + config.period},
        f"commands that act {later}": {"command_delay": dynamics.command_delay + 1},
    }
    for change, how in changes.items():
        swings = [role for k, role in roles.items() if not radius_of(k, **how) < 1.0 + _GROWTH]
        if swings:
            warnings.append(f"with {change} the loop would be unstable while {', '.join(swings)}")
    return tuple(warnings)


def spectral_radius(
    config: LawConfig,
    *,
    perturbed: int,
    robot_inertia: FloatArray,
    arm_inertia: FloatArray,
    gain: float = 1.0,
    dynamics: RigDynamics = PROMPT,
) -> float:
    """Largest factor by which a deviation from rest can grow from tick to tick.

    Exact for the laws as coded on a rig that consists of inertia only, with torque held between
    ticks and sensors read just before it changes; or with the given dynamics of drives and
    transducers.

    Parameters
    ----------
    config : ImbicConfig or PdConfig
    perturbed : joint that yields, 0-based, or NO_JOINT while all are locked
    robot_inertia, arm_inertia : (n, n) M_r(θ_0) and M_h, kg·m²
    gain : factor on M̄, or on the gains of a law without it
    dynamics : of drives and transducers; by default they are prompt
    """
    n, period = config.joints, config.period
    rig, delay = dynamics.sampled(period), dynamics.command_delay
    role, model = config.role(perturbed), config.model(perturbed)
    # Those that may act, and that which the observer believes to have acted.
    observed = int(role[LATE, 0])
    sent = max(delay, observed + 1)
    lagging = len(rig.reading) - 1
    count = 6 + sent + lagging + rig.delay + 1
    per_inertia = np.linalg.inv(robot_inertia + arm_inertia)
    # Everything is linear in the state: each of these (n, count·n) gives one vector of it.
    vectors = np.eye(count * n).reshape(count, n, count * n)
    # Of the past: two angles, or what the observer makes of it.
    theta, velocity, *past, ideal = vectors[:6]
    commands, states, readings = np.split(vectors[6:], [sent, sent + lagging])
    load = arm_inertia @ per_inertia @ readings[-1]
    if config.kind == IMBIC_OBSERVER:
        angle, measured, known = past
        acceleration = known + model[INVERSE] @ (commands[observed] - load)
        error = theta - angle - period * measured - 0.5 * period**2 * acceleration
        angle = theta - error + model[ANGLE_GAIN] @ error
        measured = measured + period * acceleration + model[VELOCITY_GAIN] @ error
        known = known + model[DISTURBANCE_GAIN] @ error
        base, past = load, [angle, measured, known]
    else:
        angle, measured = theta, (theta - past[0]) / period
        known = (theta - 2.0 * past[0] + past[1]) / period**2
        base, past = commands[0], [theta, past[0], np.zeros_like(theta)]
    if isinstance(config, ImbicConfig):
        sensed, damping, stiffness = (
            np.diag(role[row] / role[INERTIA]) for row in (SENSED, DAMPING, STIFFNESS)
        )
        u = -sensed @ load - damping @ measured - stiffness @ angle
        ideal = ideal + period * u
        torque = base + gain * config.model_inertia @ (
            u + config.gamma * (ideal - measured) - known
        )
    else:
        damping, stiffness = np.diag(role[DAMPING]), np.diag(role[STIFFNESS])
        torque = -gain * (damping @ measured + stiffness @ theta)
        ideal = np.zeros_like(ideal)
    acting = commands[delay - 1] if delay else torque
    driven = np.stack([*states, acting])
    way, speed, *states_after = np.tensordot(rig.over, driven, 1)
    following = (
        theta + period * velocity + per_inertia @ way,
        velocity + per_inertia @ speed,
        *past,
        ideal,
        torque,
        *commands[:-1],
        *states_after,
        np.tensordot(rig.reading, driven, 1),
        *readings[:-1],
    )
    return float(np.max(np.abs(np.linalg.eigvals(np.concatenate(following)))))
