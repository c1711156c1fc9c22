"""Controller and perturbation defaults: Table III of the paper, and stated assumptions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_common.sizes import JOINT_SIZES
from armimp_control.imbic import ImbicConfig
from armimp_control.perturbation import PerturbationConfig

LEVELS = (1, 2, 3)

_PEAK = 3.0  # N·m of a shoulder at level 1; the levels are multiples (Table III)
# Assumptions of the two-joint rig: M_rd (kg·m²), and B_rd, K_rd of the perturbed joint.
_TARGET_INERTIA = (0.2, 0.1)
_TARGET_DAMPING = (2.0, 1.0)
_TARGET_STIFFNESS = (10.0, 10.0)


def perturbation(level: int, joints: int) -> PerturbationConfig:
    """Perturbation at a level from 1 to 3.

    Shoulder and elbow have that of Table III: 3 and 1.8, 6 and 3.6, 9 and 5.4 N·m. Assumption: the
    peak of any joint is in proportion to its size, see :data:`armimp_common.sizes.JOINT_SIZES`.

    Raises
    ------
    ConfigurationError
        If there is no such level, or no preset for that number of joints.
    """
    if level not in LEVELS:
        raise ConfigurationError(f"perturbation level must be one of {LEVELS}, got {level}")
    if joints not in JOINT_SIZES:
        raise ConfigurationError(
            f"there is no preset perturbation for {joints} joints, only for "
            f"{min(JOINT_SIZES)} to {max(JOINT_SIZES)}"
        )
    # Rounded, so that the peaks of Table III are exact.
    return PerturbationConfig(
        peak=tuple(level * round(_PEAK * size, 6) for size in JOINT_SIZES[joints])
    )


def torque_limit(joints: int) -> float:
    """Limit of each command, N·m. Assumption.

    About twice what IMBIC commands at the first joint for one count of every encoder at resolution
    level 3, δ Σ_j M̄_1j / L²: 40 N·m for two joints, 43 for three, 67 for seven.
    """
    return 80.0 if joints <= 3 else 140.0


def imbic(robot_inertia: NDArray[np.float64], posture: NDArray[np.float64]) -> ImbicConfig:
    """Default law for a robot and a posture. Assumptions.

    M̄ = 0.6·M_r(θ_0). For two joints M_rd, B_rd and K_rd are those of the study's rig. For other
    numbers M_rd = 0.56·diag(M_r(θ_0)), and a perturbed joint has B_rd/M_rd = 10 1/s, as the rig of
    the study, and K_rd/M_rd = 100 1/s², as its elbow.

    Parameters
    ----------
    robot_inertia : (n, n) M_r(θ_0), kg·m²
    posture : (n,) θ_0, rad, which becomes the target posture
    """
    n = posture.size
    if n == 2:
        inertia = np.array(_TARGET_INERTIA)
        damping, stiffness = np.array(_TARGET_DAMPING), np.array(_TARGET_STIFFNESS)
    else:
        inertia = 0.56 * np.diag(robot_inertia)
        damping, stiffness = 10.0 * inertia, 100.0 * inertia
    return ImbicConfig(
        target_posture=posture,
        target_inertia=inertia,
        target_damping=damping,
        target_stiffness=stiffness,
        model_inertia=0.6 * robot_inertia,
    )
