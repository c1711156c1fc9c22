"""Arms, robots, friction and sensors of the study: Tables I, II of the paper, and assumptions."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.schema import row_by_row
from armimp_common.sizes import JOINT_SIZES
from armimp_sim.model.arm import CuffParameters, HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import ActuatorParameters, PlanarChain
from armimp_sim.model.sensors import ReadingParameters, SensorParameters
from armimp_sim.voluntary import VoluntaryParameters


def _radians(*degrees: float) -> tuple[float, ...]:
    return row_by_row(np.radians(degrees))


LEVELS = (0, 1, 2, 3)

JOINT_NAMES: dict[int, tuple[str, ...]] = {
    1: ("elbow",),
    2: ("shoulder", "elbow"),
    3: ("shoulder", "elbow", "wrist"),
    **{n: tuple(f"joint_{i + 1}" for i in range(n)) for n in (4, 5, 6, 7)},
}

_PAPER_JOINTS = ("shoulder", "elbow")

_ENCODER_COUNTS = (0, 204800, 102400, 51200)  # per revolution, Table II; 0: unquantised
_TORQUE_RESOLUTION = (0.0, 0.005, 0.010, 0.020)  # N·m, Table II

# Assumption (the paper only cites its source), for the two joints of the paper.
_FRICTION = (
    LuGre(),
    LuGre(coulomb=(0.4,), static=(0.5,), sigma_0=(400.0,), sigma_1=(0.8,), sigma_2=(0.04,)),
    LuGre(coulomb=(1.0,), static=(1.25,), sigma_0=(1000.0,), sigma_1=(2.0,), sigma_2=(0.10,)),
    LuGre(coulomb=(2.0,), static=(2.5,), sigma_0=(2000.0,), sigma_1=(4.0,), sigma_2=(0.20,)),
)

_ARMS = {
    1: HumanArm(posture=_radians(77.260), inertia=(0.060,), damping=(0.407,), stiffness=(6.901,)),
    2: HumanArm(
        posture=_radians(62.708, 77.260),
        inertia=(0.187, 0.084, 0.079, 0.060),
        damping=(0.651, 0.239, 0.236, 0.407),
        stiffness=(7.967, 3.187, 1.663, 6.901),
    ),
    3: HumanArm(
        posture=_radians(62.708, 77.260, 15.0),
        inertia=(0.187, 0.084, 0.0095, 0.079, 0.060, 0.0080, 0.0090, 0.0075, 0.0050),
        damping=(0.651, 0.239, 0.030, 0.236, 0.407, 0.040, 0.028, 0.036, 0.070),
        stiffness=(7.967, 3.187, 0.40, 1.663, 6.901, 0.55, 0.30, 0.45, 1.60),
    ),
}
_ROBOTS = {
    1: PlanarChain(lengths=(0.35,), moments=(0.18,), masses=(0.75,), centres=(0.22,)),
    2: PlanarChain(
        lengths=(0.30, 0.35), moments=(0.085, 0.18), masses=(0.0, 0.75), centres=(0.0, 0.22)
    ),
    3: PlanarChain(
        lengths=(0.30, 0.25, 0.10),
        moments=(0.085, 0.16, 0.015),
        masses=(0.0, 0.60, 0.20),
        centres=(0.0, 0.15, 0.04),
    ),
}

Rig = Literal["paper", "realistic"]

TRANSDUCER_NOISE = 0.005
"""Rms noise of the realistic rig's transducers (N·m). Assumption: 0.01 % of a range of 50 N·m."""
# Assumptions on the chain of equal links, see _rods.
_REACH = 0.65  # m
_FIRST, _BEND = 62.708, 77.260  # degrees
_INERTIA, _DAMPING, _STIFFNESS = 0.187, 0.651, 7.967  # of the shoulder
_DAMPING_COUPLING = 0.46
_STIFFNESS_COUPLING = (0.43, 0.22)  # above and below the diagonal
_ROBOT_SHARE = 2.0  # M_r,ii over M_h,ii
_LINK_SHARE = 0.125  # of M_r,ii


def human_arm(joints: int) -> HumanArm:
    """Return the arm: Table I of the paper for two joints, its elbow alone for one.

    Assumptions: for three joints a wrist is added; four to seven are a chain of equal links, see
    :func:`_rods`.
    """
    if joints in _ARMS:
        return _ARMS[joints]
    posture = _posture(joints)
    size = np.array(JOINT_SIZES[joints])
    mean_size = np.sqrt(np.outer(size, size))
    distance = np.arange(joints) - np.arange(joints)[:, None]
    coupling = np.where(distance > 0, *_STIFFNESS_COUPLING)
    return HumanArm(
        posture=row_by_row(posture),
        inertia=row_by_row(_rods(joints).mass_matrix(posture)),
        damping=row_by_row(_DAMPING * mean_size * _DAMPING_COUPLING ** np.abs(distance)),
        stiffness=row_by_row(_STIFFNESS * mean_size * coupling ** np.abs(distance)),
    )


def robot(joints: int) -> PlanarChain:
    """Return the exoskeleton: an assumption, constrained by an endpoint mass of about 1 kg.

    A single joint is the second of two; four to seven joints have equal links, see :func:`_rods`.
    """
    if joints in _ROBOTS:
        return _ROBOTS[joints]
    rods = _rods(joints)
    inertia = np.diag(rods.mass_matrix(_posture(joints)))
    links = _LINK_SHARE * _ROBOT_SHARE
    # The inertia at a joint includes the drives outwards of it: its own is the difference.
    drives = (_ROBOT_SHARE - links) * (inertia - np.append(inertia[1:], 0.0))
    return PlanarChain(
        lengths=rods.lengths,
        moments=row_by_row(links * np.array(rods.moments) + drives),
        masses=tuple(links * mass for mass in rods.masses),
        centres=rods.centres,
    )


def friction(level: int, joints: int) -> LuGre:
    """Return the LuGre friction of every joint at a level from 0 (none) to 3, an assumption.

    Shoulder and elbow have the same. The friction of any other joint is proportional to its size,
    as drives are: see :data:`armimp_common.sizes.JOINT_SIZES`.
    """
    law = _FRICTION[level]
    sizes = JOINT_SIZES[joints]
    named = zip(JOINT_NAMES[joints], sizes, strict=True)
    return law.scaled([1.0 if name in _PAPER_JOINTS else size for name, size in named])


def sensors(level: int, noise: float = 0.0) -> SensorParameters:
    """Return sensors with resolutions of a level from 0 (unquantised) to 3 (Table II).

    Noise is that of the torque transducers, N·m.
    """
    counts = _ENCODER_COUNTS[level]
    return SensorParameters(
        position=ReadingParameters(resolution=2.0 * np.pi / counts if counts else 0.0),
        torque=ReadingParameters(resolution=_TORQUE_RESOLUTION[level], noise=noise),
    )


def realistic(joints: int) -> dict[str, Any]:
    """Return what a good real rig has and the paper's lacks, by group of simulator parameters.

    All of it is assumption. With four joints or more, cuff and person suit the smallest joint.
    """
    size = 1.0 if joints <= 3 else min(JOINT_SIZES[joints])
    return {
        # A servo drive, and one cycle of a field bus.
        "actuators": ActuatorParameters(bandwidth=200.0, delay=0.001),
        # A cast rather than straps.
        "cuff": CuffParameters(stiffness=1e5 * size, damping=100.0 * size),
        # Small efforts of a person who tries to relax; for tremor, accelerations of 0.1 m/s² at
        # 0.35 m of the elbow's inertia.
        "voluntary": VoluntaryParameters(rms=0.3 * size, tremor=0.02 * size),
    }


def _posture(joints: int) -> FloatArray:
    rest = joints - 1
    return np.radians([_FIRST] + [_BEND / rest] * rest)


def _rods(joints: int) -> PlanarChain:
    """Return the segments of the assumed arm of four to seven joints.

    No arm has so many parallel joints; this is a test case for the method at larger n. All of it
    is assumption, by one rule that ties it to the arm of the paper and the robot with two joints:

    - n equal segments reach as far as the two of that robot together. The first joint stands as the
      shoulder does; the bend of the elbow is spread evenly over the other joints.
    - The arm: uniform rods. M_h is that of the chain of rods, with their mass such that the first
      diagonal element is that of the shoulder. Damping and stiffness are those of the shoulder
      times the size of the joint (:data:`armimp_common.sizes.JOINT_SIZES`). Between joints i and j
      they are √(X_ii X_jj) c^|i−j|, with c from the two joints of the paper: 0.46 in damping, and
      in stiffness 0.43 above and 0.22 below the diagonal.
    - The robot: M_r,ii(θ_0) = 2 M_h,ii, of which an eighth are links, shaped as the arm, and the
      rest are drives. (Without drives the chain is so light in some directions that the bristles of
      friction oscillate faster there than any law sampled at the control period can follow.)
    """
    length = _REACH / joints

    def rods(mass: float) -> PlanarChain:
        return PlanarChain(
            lengths=(length,) * joints,
            moments=(mass * length**2 / 3.0,) * joints,
            masses=(mass,) * joints,
            centres=(length / 2.0,) * joints,
        )

    return rods(_INERTIA / float(rods(1.0).mass_matrix(_posture(joints))[0, 0]))
