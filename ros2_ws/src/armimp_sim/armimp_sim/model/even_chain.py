"""The assumed arm and robot of four to seven joints: a chain of equal segments.

No arm has so many parallel joints; this is a test piece for the method at larger n. All of it is
assumption, by one rule that ties it to the arm of the paper and the robot with two joints:

- n equal segments reach as far as the two of that robot together. The first joint stands as the
  shoulder does; the bend of the elbow is spread evenly over the other joints.
- The arm: uniform rods. M_h is that of the chain of rods, with their mass such that the first
  diagonal element is that of the shoulder. Damping and stiffness are those of the shoulder times
  the size of the joint (:data:`armimp_common.sizes.JOINT_SIZES`). Between joints i and j they are
  √(X_ii X_jj) c^|i−j|, with c from the two joints of the paper: 0.46 in damping, and in stiffness
  0.43 above and 0.22 below the diagonal.
- The robot: M_r,ii(θ_0) = 2 M_h,ii, of which an eighth are links, shaped as the arm, and the rest
  are drives. (Without drives the chain is so light in some directions that bristles of friction
  swing faster there than the control period, which no sampled law can follow.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_common.sizes import JOINT_SIZES
from armimp_sim.model.arm import HumanArm
from armimp_sim.model.robot import PlanarChain

JOINTS = (4, 5, 6, 7)

_REACH = 0.65  # m
_FIRST, _BEND = 62.708, 77.260  # degrees
_INERTIA, _DAMPING, _STIFFNESS = 0.187, 0.651, 7.967  # of the shoulder
_DAMPING_COUPLING = 0.46
_STIFFNESS_COUPLING = (0.43, 0.22)  # above and below the diagonal
_ROBOT_SHARE = 2.0  # M_r,ii over M_h,ii
_LINK_SHARE = 0.125  # of M_r,ii


def arm(joints: int) -> HumanArm:
    """The arm with 4 to 7 joints."""
    posture = _posture(joints)
    size = np.array(JOINT_SIZES[joints])
    mean_size = np.sqrt(np.outer(size, size))
    distance = np.arange(joints) - np.arange(joints)[:, None]
    coupling = np.where(distance > 0, *_STIFFNESS_COUPLING)
    return HumanArm(
        posture=posture,
        inertia=_rods(joints).mass_matrix(posture),
        damping=_DAMPING * mean_size * _DAMPING_COUPLING ** np.abs(distance),
        stiffness=_STIFFNESS * mean_size * coupling ** np.abs(distance),
    )


def robot(joints: int) -> PlanarChain:
    """The robot for it."""
    rods = _rods(joints)
    inertia = np.diag(rods.mass_matrix(_posture(joints)))
    links = _LINK_SHARE * _ROBOT_SHARE
    # What a joint has more of than the next one outwards is its own.
    drives = (_ROBOT_SHARE - links) * (inertia - np.append(inertia[1:], 0.0))
    return PlanarChain(
        lengths=rods.lengths,
        moments=links * rods.moments + drives,
        masses=links * rods.masses,
        centres=rods.centres,
    )


def _posture(joints: int) -> NDArray[np.float64]:
    rest = joints - 1
    return np.radians([_FIRST] + [_BEND / rest] * rest)


def _rods(joints: int) -> PlanarChain:
    """The segments of the arm."""
    length = _REACH / joints

    def rods(mass: float) -> PlanarChain:
        return PlanarChain(
            lengths=np.full(joints, length),
            moments=np.full(joints, mass * length**2 / 3.0),
            masses=np.full(joints, mass),
            centres=np.full(joints, length / 2.0),
        )

    return rods(_INERTIA / float(rods(1.0).mass_matrix(_posture(joints))[0, 0]))
