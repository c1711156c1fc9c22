"""Preset control laws, and limits of nothing but the torque."""

from dataclasses import replace

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_control.laws import Law
from armimp_control.parameters import ControllerParameters
from armimp_control.presets import LawName
from armimp_control.safety_limiter import SafetyParameters
from armimp_sim.presets import human_arm, robot

ARM, POSTURE = human_arm(2).M, human_arm(2).theta_0
ROBOT = robot(2).mass_matrix(POSTURE)
"""Inertia of the robot of the study in its posture, kg·m², as that of the arm."""


def preset_law(
    robot_inertia: FloatArray,
    posture: FloatArray,
    law: LawName = "observer",
    encoder_resolution: float = 0.0,
) -> Law:
    """One of the preset laws for a robot (n, n), kg·m², in a posture (n,), rad.

    The arm is that of the study if there are two joints.
    """
    return ControllerParameters.preset(
        joints=tuple(f"joint_{i + 1}" for i in range(posture.size)),
        posture=posture,
        robot_inertia=robot_inertia,
        arm_inertia=ARM if posture.size == 2 else np.eye(posture.size),
        encoder_resolution=encoder_resolution,
        law=law,
    ).control_law()


def with_law(law: Law, **values: object) -> Law:
    """The law with other values of its parameters ``law.*``."""
    return replace(law, law=law.law.model_copy(update=values))


def knowing(law: Law, **values: object) -> Law:
    """The law with other values of its parameters ``known.*``."""
    return replace(law, known=law.known.model_copy(update=values))


def torque_only(limit: float) -> SafetyParameters:
    """Limits of the torque alone, N·m; values that are not finite still stop the limiter."""
    return SafetyParameters(
        position_limit=(1e300,),
        velocity_limit=(1e300,),
        torque_limit=limit,
        rate_limit=1e306,
        power_limit=1e306,
    )


def within_torque(command: FloatArray, limit: float) -> FloatArray:
    """Scale a command (n,), N·m, so that no joint gets more torque than the limit."""
    share = max(1.0, float(np.max(np.abs(command))) / limit)
    return np.asarray(command / share)
