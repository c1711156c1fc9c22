"""Presets of one to seven joints: the rules that they follow, and that they make sound plants."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.sizes import JOINT_SIZES
from armimp_sim import presets
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import PlantConfig

Array = NDArray[np.float64]
ALL = range(1, 8)


def _inertia(joints: int, deflection: Array | None = None) -> tuple[Array, Array]:
    """M_r, at a deflection from the posture, and M_h."""
    arm = presets.human_arm(joints)
    away = np.zeros(joints) if deflection is None else deflection
    return presets.robot(joints).mass_matrix(arm.posture + away), arm.inertia


def _total(joints: int, deflection: Array | None = None) -> Array:
    robot, arm = _inertia(joints, deflection)
    return robot + arm


@pytest.mark.parametrize("joints", ALL)
@pytest.mark.parametrize("friction", presets.LEVELS)
def test_every_number_of_joints_makes_a_plant_at_every_level(joints: int, friction: int) -> None:
    parameters = SimulatorParameters.preset(joints=joints, friction=friction)
    config = parameters.plant_config()
    assert isinstance(config, PlantConfig)
    assert config.joints == joints == len(set(parameters.joints))
    assert config.step == pytest.approx(1e-5)


@pytest.mark.parametrize("joints", ALL)
def test_sizes_of_joints_are_inertias_to_the_power_of_three_fifths(joints: int) -> None:
    inertia = np.diag(_total(joints))
    shoulder = _total(2)[0, 0] if joints == 1 else inertia[0]
    rule, sizes = (inertia / shoulder) ** 0.6, JOINT_SIZES[joints]
    # Shoulder and elbow of the paper have the ratio of its Table III instead.
    paper = {1: (0.6,), 2: (1.0, 0.6), 3: (1.0, 0.6)}.get(joints, ())
    known = len(paper)
    assert sizes[:known] == paper
    assert paper == pytest.approx(tuple(rule[:known]), rel=0.05)
    assert sizes[known:] == pytest.approx(tuple(rule[known:]), rel=0.03)
