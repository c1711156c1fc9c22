"""The law that a controller has by a preset."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_control.laws.imbic import ImbicConfig
from armimp_control.parameters import ControllerParameters
from armimp_control.presets import LawName


def preset_law(
    robot_inertia: NDArray[np.float64],
    posture: NDArray[np.float64],
    law: LawName = "observer",
    encoder_resolution: float = 0.0,
) -> ImbicConfig:
    """One of the preset laws for a robot (n, n), kg·m², in a posture (n,), rad."""
    return ControllerParameters.preset(
        joints=tuple(f"joint_{i + 1}" for i in range(posture.size)),
        posture=posture,
        robot_inertia=robot_inertia,
        arm_inertia=np.eye(posture.size),
        encoder_resolution=encoder_resolution,
        law=law,
    ).imbic_config()
