"""Presets: the paper's tables, what the design assumes, and one to seven joints."""

from typing import Any

import numpy as np
import pytest

from armimp_common.arrays import FloatArray as Array
from armimp_common.errors import ConfigurationError
from armimp_common.schema import build, flatten
from armimp_common.sizes import JOINT_SIZES
from armimp_sim import presets
from armimp_sim.model.sensors import Sampling
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig


def test_arm_is_that_of_table_one() -> None:
    arm = presets.human_arm(2)
    assert np.degrees(arm.posture) == pytest.approx([62.708, 77.260], rel=1e-14)
    assert arm.M.tolist() == [[0.187, 0.084], [0.079, 0.060]]
    assert arm.B.tolist() == [[0.651, 0.239], [0.236, 0.407]]
    assert arm.K.tolist() == [[7.967, 3.187], [1.663, 6.901]]


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
    law = presets.friction(level, 2).of_joints(2)
    for joint in range(2):
        assert tuple(one[joint] for one in law.values()) == (*values, 0.01)


# --- Presets of one to seven joints: the rules that they follow, and that they make sound plants


ALL = range(1, 8)


def inertia_of(joints: int) -> Array:
    """Of robot and arm in the posture."""
    arm = presets.human_arm(joints)
    return presets.robot(joints).mass_matrix(arm.theta_0) + arm.M


@pytest.mark.parametrize("joints", ALL)
@pytest.mark.parametrize("friction", presets.LEVELS)
def test_every_number_of_joints_makes_a_plant_at_every_level(joints: int, friction: int) -> None:
    parameters = SimulatorParameters.preset(joints=joints, friction=friction)
    parameters.check()
    assert joints == len(set(parameters.joints))
    assert parameters.substeps == 100


@pytest.mark.parametrize("joints", ALL)
def test_sizes_of_joints_are_inertias_to_the_power_of_three_fifths(joints: int) -> None:
    inertia = np.diag(inertia_of(joints))
    shoulder = inertia_of(2)[0, 0] if joints == 1 else inertia[0]
    rule, sizes = (inertia / shoulder) ** 0.6, JOINT_SIZES[joints]
    # Shoulder and elbow of the paper have the ratio of its Table III instead.
    paper = {1: (0.6,), 2: (1.0, 0.6), 3: (1.0, 0.6)}.get(joints, ())
    known = len(paper)
    assert sizes[:known] == paper
    assert paper == pytest.approx(tuple(rule[:known]), rel=0.05)
    assert sizes[known:] == pytest.approx(tuple(rule[known:]), rel=0.03)


PRESET = flatten(SimulatorParameters.preset())
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("arm.damping", [(1.0, 2.0), (1.0, 2.0, 3.0, NAN)]),
        ("arm.inertia", [(-1.0, 0.0, 0.0, 1.0)]),
        ("arm.posture", [(1.0, INF)]),
        ("arm.stiffness", [(1.0, 0.0, 0.0, NAN)]),
        ("robot.lengths", [(0.3, -0.3), (NAN, 0.3)]),
        ("robot.moments", [(0.1, 0.0), (0.1, INF)]),
        ("robot.masses", [(1.0, -0.5)]),
        ("robot.centres", [(0.1, NAN)]),
        ("friction.sigma_0", [(1.0,) * 3, (-1.0, 1.0), (INF, 1.0)]),
        ("friction.coulomb", [(-0.25, 1.0), (NAN, 1.0), (0.0, 1.0)]),
        ("friction.static", [(0.0, 0.0), (INF, 1.0)]),
        ("friction.sigma_1", [(NAN, 1.0)]),
        ("friction.sigma_2", [(-1e-9, 1.0)]),
        ("friction.stribeck_velocity", [(0.0, 1.0)]),
        ("sensors.position.resolution", [-0.25, NAN, INF]),
        ("sensors.torque.offset", [(NAN,), (1.0,) * 3, ()]),
        ("sensors.torque.gain", [(1.0, 0.0)]),
        ("actuators.bandwidth", [INF, -1.0, 0.5]),
        ("reflex.velocity_gain", [(1.0,) * 3]),
        ("muscle.short_range_stiffness", [(1.0,) * 3]),
        ("cuff.stiffness", [-1.0, 1e10]),
        ("voluntary.tremor_high", [7.0, 500.0]),
        ("voluntary.cutoff", [0.0, 500.0]),
        ("watchdog_ticks", [0, 101]),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_and_named(name: str, values: list[Any]) -> None:
    for value in values:
        group, _, short = name.rpartition(".")
        with pytest.raises(ConfigurationError, match=f"{short}|'{group}'|{group}:|step") as caught:
            SimulatedRig(build(SimulatorParameters, {**PRESET, name: value}))
        assert "\n" not in str(caught.value)
