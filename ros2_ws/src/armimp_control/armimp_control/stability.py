"""Stability of the sampled loop, checked before the law is allowed to move anything."""

from __future__ import annotations

from typing import Any

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.errors import ConfigurationError
from armimp_common.schema import matrix
from armimp_common.topics import PERIOD
from armimp_control.laws import (
    ANGLE_GAIN,
    DAMPING,
    DISTURBANCE_GAIN,
    IMBIC_OBSERVER,
    INERTIA,
    INERTIA_MODEL,
    INVERSE,
    LATE,
    NO_JOINT,
    SENSED,
    STIFFNESS,
    VELOCITY_GAIN,
    Law,
)
from armimp_control.laws.imbic import Imbic
from armimp_control.rig import RigDynamics

WARNING_GAIN = 1.25
"""Factor by which gains may become larger without a warning of instability."""
ARM_RANGE = 3.0
"""Factor by which the arm may be heavier or lighter than known."""
_GROWTH = 1e-4
"""Growth per tick attributed to rounding; without target stiffness and damping, motion persists."""


def check_stability(law: Law) -> tuple[str, ...]:
    """Check the sampled loop with every joint perturbed in turn, and with all locked.

    The loop of law and inertia must return to rest, see :func:`spectral_radius`, with the arm as it
    is known and with one that is heavier or lighter by a factor of 3. Warnings name changes with
    which the loop would be unstable: larger gains, or torques or commands one period later.

    Parameters
    ----------
    law : holds what is known of robot, arm, drives and transducers

    Returns
    -------
    tuple of str
        The warnings, one sentence each.

    Raises
    ------
    ConfigurationError
        If the loop is unstable or the inertia makes no sense; the message carries the value.
    """
    dynamics, (robot_inertia, arm_inertia) = law.known, _inertia(law)
    total = robot_inertia + arm_inertia
    smallest = float(np.linalg.eigvalsh(0.5 * (total + total.T))[0])
    if not smallest > 0.0:
        raise ConfigurationError(
            "controller: M_r + M_h must have a positive definite symmetric part, "
            f"its smallest eigenvalue is {smallest:.3g} kg·m²"
        )

    def radius_of(k: int, gain: float = 1.0, arm: float = 1.0, **changed: float) -> float:
        changed_dynamics = dynamics.model_copy(update=changed)
        return spectral_radius(law, changed_dynamics, perturbed=k, gain=gain, arm=arm)

    roles = {k: f"joint {k + 1} is perturbed" for k in range(law.joints)}
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
    gains = "M̄" if isinstance(law, Imbic) else "gains"
    later = f"{1e3 * PERIOD:g} ms later"
    changes: dict[str, dict[str, Any]] = {
        f"{gains} larger by {WARNING_GAIN - 1.0:.0%}": {"gain": WARNING_GAIN},
        f"torques read {later}": {"torque_delay": dynamics.torque_delay + PERIOD},
        f"commands that act {later}": {"command_delay": dynamics.command_delay + 1},
    }
    for change, how in changes.items():
        swings = [role for k, role in roles.items() if not radius_of(k, **how) < 1.0 + _GROWTH]
        if swings:
            warnings.append(f"with {change} the loop would be unstable while {', '.join(swings)}")
    return tuple(warnings)


def spectral_radius(
    law: Law, dynamics: RigDynamics, *, perturbed: int, gain: float = 1.0, arm: float = 1.0
) -> float:
    """Return the spectral radius of the sampled loop: the growth per tick of its worst motion.

    It is exact for the laws as coded, on a rig that consists of inertia only and of the given
    dynamics of drives and transducers, with commands held between ticks and sensors read just
    before the command changes.

    Parameters
    ----------
    law : holds the known inertia of robot and arm
    dynamics : of drives and transducers
    perturbed : joint that yields, 0-based, or NO_JOINT while all are locked
    gain : factor on M̄, or on the gains of a law without it
    arm : factor on the inertia of the arm
    """
    n, period = law.joints, PERIOD
    robot_inertia, arm_inertia = _inertia(law, arm)
    rig, delay = dynamics.sampled(), dynamics.command_delay
    role, model = law.role(perturbed), law.model(perturbed)
    # Commands in the state: those yet to act, and the one that the observer takes to have acted.
    observed = int(role[LATE, 0])
    sent = max(delay, observed + 1)
    lagging = len(rig.reading) - 1
    count = 6 + sent + lagging + rig.delay + 1
    per_inertia = np.linalg.inv(robot_inertia + arm_inertia)
    # Everything is linear in the state: each of these matrices (n, count·n) gives one vector of it.
    vectors = np.eye(count * n).reshape(count, n, count * n)
    # The past is two angles, or the three vectors that the observer has made of it.
    theta, velocity, *past, ideal = vectors[:6]
    commands, states, readings = np.split(vectors[6:], [sent, sent + lagging])
    load = arm_inertia @ per_inertia @ readings[-1]
    if law.kind == IMBIC_OBSERVER:
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
    if isinstance(law, Imbic):
        sensed, damping, stiffness = (
            np.diag(role[row] / role[INERTIA]) for row in (SENSED, DAMPING, STIFFNESS)
        )
        u = -sensed @ load - damping @ measured - stiffness @ angle
        ideal = ideal + period * u
        torque = base + gain * model[INERTIA_MODEL] @ (
            u + law.law.gamma * (ideal - measured) - known
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


def _inertia(law: Law, arm: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Return M_r(θ_0), and M_h times `arm`, both (n, n), kg·m², as the law knows them."""
    known, n = law.known, law.joints
    return (
        matrix("known.robot_inertia", known.robot_inertia, n),
        arm * matrix("known.arm_inertia", known.arm_inertia, n),
    )
