"""The arms, robots and levels of the study: Tables I and II of the paper, and assumptions."""

from __future__ import annotations

import numpy as np

from armimp_common.errors import ConfigurationError
from armimp_common.sizes import JOINT_SIZES
from armimp_sim.model import even_chain
from armimp_sim.model.arm import HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import PlanarChain
from armimp_sim.model.sensors import Sampling, Sensors

LEVELS = (0, 1, 2, 3)

JOINT_NAMES: dict[int, tuple[str, ...]] = {
    1: ("elbow",),
    2: ("shoulder", "elbow"),
    3: ("shoulder", "elbow", "wrist"),
    **{n: tuple(f"joint_{i + 1}" for i in range(n)) for n in even_chain.JOINTS},
}

_PAPER_JOINTS = ("shoulder", "elbow")

_ENCODER_COUNTS = (0, 204800, 102400, 51200)  # per revolution, Table II; 0: unquantised
_TORQUE_RESOLUTION = (0.0, 0.005, 0.010, 0.020)  # N·m, Table II

# Assumption (the paper only cites its source), for the two joints of the paper.
_FRICTION = (
    LuGre.none(),
    LuGre(coulomb=0.4, static=0.5, sigma_0=400.0, sigma_1=0.8, sigma_2=0.04),
    LuGre(coulomb=1.0, static=1.25, sigma_0=1000.0, sigma_1=2.0, sigma_2=0.10),
    LuGre(coulomb=2.0, static=2.5, sigma_0=2000.0, sigma_1=4.0, sigma_2=0.20),
)


def human_arm(joints: int) -> HumanArm:
    """The arm: Table I of the paper for two joints, its elbow alone for one.

    Assumptions: for three joints a wrist is added; four to seven are those of
    :mod:`armimp_sim.model.even_chain`.

    Raises
    ------
    ConfigurationError
        If there is no preset for that number of joints.
    """
    _check_joints("arm", joints)
    if joints <= 2:
        kept = slice(2 - joints, 2)
        return HumanArm(
            posture=np.radians([62.708, 77.260])[kept],
            inertia=np.array([[0.187, 0.084], [0.079, 0.060]])[kept, kept],
            damping=np.array([[0.651, 0.239], [0.236, 0.407]])[kept, kept],
            stiffness=np.array([[7.967, 3.187], [1.663, 6.901]])[kept, kept],
        )
    if joints == 3:
        return HumanArm(
            posture=np.radians([62.708, 77.260, 15.0]),
            inertia=np.array(
                [[0.187, 0.084, 0.0095], [0.079, 0.060, 0.0080], [0.0090, 0.0075, 0.0050]]
            ),
            damping=np.array([[0.651, 0.239, 0.030], [0.236, 0.407, 0.040], [0.028, 0.036, 0.070]]),
            stiffness=np.array([[7.967, 3.187, 0.40], [1.663, 6.901, 0.55], [0.30, 0.45, 1.60]]),
        )
    return even_chain.arm(joints)


def robot(joints: int) -> PlanarChain:
    """The exoskeleton. Assumption, constrained by an endpoint mass of about 1 kg.

    One joint is the second of two; four to seven are those of :mod:`armimp_sim.model.even_chain`.

    Raises
    ------
    ConfigurationError
        If there is no preset for that number of joints.
    """
    _check_joints("robot", joints)
    if joints <= 2:
        kept = slice(2 - joints, 2)
        return PlanarChain(
            lengths=np.array([0.30, 0.35])[kept],
            moments=np.array([0.085, 0.18])[kept],
            masses=np.array([0.0, 0.75])[kept],
            centres=np.array([0.0, 0.22])[kept],
        )
    if joints == 3:
        return PlanarChain(
            lengths=np.array([0.30, 0.25, 0.10]),
            moments=np.array([0.085, 0.16, 0.015]),
            masses=np.array([0.0, 0.60, 0.20]),
            centres=np.array([0.0, 0.15, 0.04]),
        )
    return even_chain.robot(joints)


def friction(level: int, joints: int) -> tuple[LuGre, ...]:
    """LuGre friction of every joint at a level from 0 (none) to 3. Assumption.

    Shoulder and elbow have the same. The friction of any other joint is in proportion to its size,
    as drives are: see :data:`armimp_common.sizes.JOINT_SIZES`.

    Raises
    ------
    ConfigurationError
        If there is no such level, or no preset for that number of joints.
    """
    law = _FRICTION[_checked("friction", level)]
    _check_joints("friction", joints)
    return tuple(
        law.scaled(1.0 if name in _PAPER_JOINTS else size)
        for name, size in zip(JOINT_NAMES[joints], JOINT_SIZES[joints], strict=True)
    )


def sensors(level: int, sampling: Sampling = Sampling.BEFORE_UPDATE) -> Sensors:
    """Encoder and torque resolution at a level from 0 (unquantised) to 3 (Table II).

    Raises
    ------
    ConfigurationError
        If there is no such level.
    """
    counts = _ENCODER_COUNTS[_checked("resolution", level)]
    return Sensors(
        encoder_resolution=2.0 * np.pi / counts if counts else 0.0,
        torque_resolution=_TORQUE_RESOLUTION[level],
        sampling=sampling,
    )


def _checked(name: str, level: int) -> int:
    if level not in LEVELS:
        raise ConfigurationError(f"{name} level must be one of {LEVELS}, got {level}")
    return level


def _check_joints(what: str, joints: int) -> None:
    if joints not in JOINT_NAMES:
        raise ConfigurationError(
            f"there is no preset {what} with {joints} joints, only with "
            f"{min(JOINT_NAMES)} to {max(JOINT_NAMES)}"
        )
