"""Controller and perturbation defaults: Table III of the paper, and stated assumptions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_control.imbic import ImbicConfig
from armimp_control.perturbation import PerturbationConfig

LEVELS = (1, 2, 3)

# N·m at level 1; the levels are multiples (Table III: 3/1.8, 6/3.6, 9/5.4 N·m).
# Third joint: assumption.
_PEAK: dict[int, tuple[float, ...]] = {2: (3.0, 1.8), 3: (3.0, 1.8, 0.3)}
# Assumptions of the two-joint rig: M_rd (kg·m²), and B_rd, K_rd of the perturbed joint.
_TARGET_INERTIA = (0.2, 0.1)
_TARGET_DAMPING = (2.0, 1.0)
_TARGET_STIFFNESS = (10.0, 10.0)


def perturbation(level: int, joints: int) -> PerturbationConfig:
    """Perturbation at a level from 1 to 3 (Table III; a third joint is an assumption).

    Raises
    ------
    ConfigurationError
        If there is no such level, or no preset for that number of joints.
    """
    if level not in LEVELS:
        raise ConfigurationError(f"perturbation level must be one of {LEVELS}, got {level}")
    if joints not in _PEAK:
        raise ConfigurationError(
            f"there is no preset perturbation for {joints} joints, only {tuple(_PEAK)}"
        )
    return PerturbationConfig(peak=tuple(level * peak for peak in _PEAK[joints]))


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
