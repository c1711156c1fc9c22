"""Sampled stability of the law, checked before it is allowed to move anything."""

from __future__ import annotations

from dataclasses import dataclass

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
    def none(self) -> bool:
        """Whether commands, drives and readings are prompt."""
        return not (
            self.command_delay or self.actuator_lag or self.torque_delay or self.torque_cutoff
        )

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
    """From tick to tick, for a command u: states x of drive and low-pass, and what is read."""

    transition: FloatArray
    from_command: FloatArray
    """(q, q), (q,) of ``x ← transition · x + from_command · u``."""
    reading_from_state: FloatArray
    reading_from_command: float
    """(q,) and one number: the reading, as torque of the drive, from x before and u during the
    last period."""
    delay: int
    """Ticks that it comes later."""
    drive_lags: bool
    """Whether the first state is the torque of the drive."""
    speed: tuple[float, float]
    way: tuple[float, float]
    """What velocity (s) and angle (s²) gain per unit of torque / inertia of the drive at the start
    of a period, and of the command in it."""

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


def check_stability(
    config: LawConfig,
    *,
    robot_inertia: FloatArray,
    arm_inertia: FloatArray,
    dynamics: RigDynamics | None = None,
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
    _check_inertia(config.joints, robot_inertia, arm_inertia)
    gains = "M̄" if isinstance(config, ImbicConfig) else "gains"
    known = dynamics or RigDynamics()
    later = known.model_copy(update={"torque_delay": known.torque_delay + config.period})
    later_command = known.model_copy(update={"command_delay": known.command_delay + 1})

    def radius_of(k: int, assumed: RigDynamics, gain: float = 1.0, arm: float = 1.0) -> float:
        return spectral_radius(
            config,
            perturbed=k,
            robot_inertia=robot_inertia,
            arm_inertia=arm * arm_inertia,
            gain=gain,
            dynamics=assumed,
        )

    roles = {k: f"joint {k + 1} is perturbed" for k in range(config.joints)}
    roles[NO_JOINT] = "all joints are locked"
    arms = {
        1.0: "",
        ARM_RANGE: f" with an arm {ARM_RANGE:g} times as heavy",
        1.0 / ARM_RANGE: f" with an arm {ARM_RANGE:g} times as light",
    }
    for k, role in roles.items():
        for arm, described in arms.items():
            radius = radius_of(k, known, arm=arm)
            if not radius < 1.0 + _GROWTH:
                raise ConfigurationError(
                    f"controller: unstable when sampled: while {role}, motion grows by a factor of "
                    f"{radius:.4g} per tick{described}" + _with(known)
                )
    warnings = []
    changes = {
        f"{gains} larger by {WARNING_GAIN - 1.0:.0%}": (known, WARNING_GAIN),
        f"torques read {1e3 * config.period:g} ms later": (later, 1.0),
        f"commands that act {1e3 * config.period:g} ms later": (later_command, 1.0),
    }
    for change, (assumed, gain) in changes.items():
        swings = [
            role for k, role in roles.items() if not radius_of(k, assumed, gain) < 1.0 + _GROWTH
        ]
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
    dynamics: RigDynamics | None = None,
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
    rig = (dynamics or RigDynamics()).sampled(period)
    # A prompt reading is that of the last command, which is part of the state anyway.
    late = rig.delay + 1 if dynamics is not None and not dynamics.none else 0
    delay = 0 if dynamics is None else dynamics.command_delay
    role, model = config.role(perturbed), config.model(perturbed)
    # Those that may act, and that which the observer believes to have acted.
    observed = int(role[LATE, 0])
    sent = max(delay, observed + 1)
    count = 6 + sent + rig.states + late
    per_inertia = np.linalg.inv(robot_inertia + arm_inertia)
    # Everything is linear in the state: each of these (n, count·n) gives one vector of it.
    vectors = np.eye(count * n).reshape(count, n, count * n)
    # Of the past: two angles, or what the observer makes of it.
    theta, velocity, *past, ideal = vectors[:6]
    commands, states, readings = np.split(vectors[6:], [sent, sent + rig.states])
    load = arm_inertia @ per_inertia @ (readings[-1] if late else commands[0])
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
    drive = states[0] if rig.drive_lags else np.zeros_like(theta)
    newest = np.tensordot(rig.reading_from_state, states, 1) + rig.reading_from_command * acting
    following = (
        theta + period * velocity + per_inertia @ (rig.way[0] * drive + rig.way[1] * acting),
        velocity + per_inertia @ (rig.speed[0] * drive + rig.speed[1] * acting),
        *past,
        ideal,
        torque,
        *commands[:-1],
        *(
            np.tensordot(row, states, 1) + share * acting
            for row, share in zip(rig.transition, rig.from_command, strict=True)
        ),
        *([newest, *readings[:-1]] if late else []),
    )
    return float(np.max(np.abs(np.linalg.eigvals(np.concatenate(following)))))


def _with(dynamics: RigDynamics) -> str:
    """The dynamics in words, for an error that they may be the reason of."""
    if dynamics.none:
        return ""
    return (
        f", with commands that act {dynamics.command_delay} periods late, torques read "
        f"{1e3 * dynamics.torque_delay:g} ms late, a low-pass at "
        f"{dynamics.torque_cutoff:g} Hz (0: none) and drives that lag by "
        f"{1e3 * dynamics.actuator_lag:g} ms"
    )


def _check_inertia(n: int, robot_inertia: FloatArray, arm_inertia: FloatArray) -> None:
    for name, matrix in (("M_r", robot_inertia), ("M_h", arm_inertia)):
        if matrix.shape != (n, n) or not np.all(np.isfinite(matrix)):
            raise ConfigurationError(
                f"controller: {name} needs {n}×{n} finite values: {matrix.tolist()}"
            )
    total = robot_inertia + arm_inertia
    smallest = float(np.linalg.eigvalsh(0.5 * (total + total.T))[0])
    if not smallest > 0.0:
        raise ConfigurationError(
            "controller: M_r + M_h must have a positive definite symmetric part, "
            f"its smallest eigenvalue is {smallest:.3g} kg·m²"
        )
