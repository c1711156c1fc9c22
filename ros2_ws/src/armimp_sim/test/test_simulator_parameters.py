"""Values that make no rig are refused, each with its name and the value."""

from typing import Any

import pytest

from armimp_common.errors import ConfigurationError
from armimp_common.schema import build, flatten
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig

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
        ("sensors.torque.delay", [0.2, -0.001]),
        ("sensors.torque.cutoff", [-3.0]),
        ("sensors.torque.order", [0, 5]),
        ("actuators.bandwidth", [INF, -1.0, 0.5]),
        ("actuators.delay", [0.5]),
        ("reflex.velocity_gain", [(1.0,) * 3]),
        ("muscle.short_range_stiffness", [(1.0,) * 3]),
        ("cuff.stiffness", [-1.0, 1e10]),
        ("voluntary.tremor_high", [7.0, 500.0]),
        ("voluntary.rms", [-0.5, NAN]),
        ("voluntary.cutoff", [0.0, 500.0]),
        ("substeps", [0]),
        ("watchdog_ticks", [0, 101]),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_and_named(name: str, values: list[Any]) -> None:
    for value in values:
        group, _, short = name.rpartition(".")
        with pytest.raises(ConfigurationError, match=f"{short}|'{group}'|{group}:|step") as caught:
            SimulatedRig(build(SimulatorParameters, {**PRESET, name: value}))
        assert "\n" not in str(caught.value)
