"""Presets of the study: the paper's tables, and what the design assumes."""

from __future__ import annotations

import numpy as np
import pytest

from armimp_sim import presets
from armimp_sim.model.sensors import Sampling


def test_arm_is_that_of_table_one() -> None:
    arm = presets.human_arm(2)
    assert np.degrees(arm.posture) == pytest.approx([62.708, 77.260], rel=1e-14)
    assert arm.inertia.tolist() == [[0.187, 0.084], [0.079, 0.060]]
    assert arm.damping.tolist() == [[0.651, 0.239], [0.236, 0.407]]
    assert arm.stiffness.tolist() == [[7.967, 3.187], [1.663, 6.901]]


@pytest.mark.parametrize(
    ("level", "counts", "degrees", "torque"),
    [
        (1, 204800, 1.758e-3, 0.005),
        (2, 102400, 3.516e-3, 0.010),
        (3, 51200, 7.031e-3, 0.020),
    ],
)
def test_resolutions_are_those_of_table_two(
    level: int, counts: int, degrees: float, torque: float
) -> None:
    sensors = presets.sensors(level)
    assert np.degrees(sensors.position.resolution) == pytest.approx(360.0 / counts, rel=1e-14)
    assert np.degrees(sensors.position.resolution) == pytest.approx(degrees, abs=5e-7)
    assert sensors.torque.resolution == torque
    assert sensors.sampling is Sampling.BEFORE_UPDATE


@pytest.mark.parametrize(
    ("level", "values"),
    [
        (0, (0.0, 0.0, 0.0, 0.0, 0.0)),
        (1, (0.4, 0.5, 400.0, 0.8, 0.04)),
        (2, (1.0, 1.25, 1000.0, 2.0, 0.10)),
        (3, (2.0, 2.5, 2000.0, 4.0, 0.20)),
    ],
)
def test_friction_is_that_of_the_design(level: int, values: tuple[float, ...]) -> None:
    for law in presets.friction(level, 2):
        assert (law.coulomb, law.static, law.sigma_0, law.sigma_1, law.sigma_2) == values
        assert law.stribeck_velocity == 0.01
