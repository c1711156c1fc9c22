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
        ("robot.lengths", [(0.3, -0.3)]),
        ("robot.moments", [(0.1, 0.0)]),
        ("friction.sigma_0", [(1.0,), (-1.0, 1.0), (INF, 1.0)]),
        ("friction.static", [(0.0, 0.0)]),
        ("sensors.encoder_resolution", [-0.25, NAN, INF]),
        ("sensors.torque_offset", [(NAN,), (1.0,) * 3, ()]),
        ("sensors.torque_gain", [(1.0, 0.0)]),
        ("sensors.torque_delay", [0.2, -0.001]),
        ("sensors.torque_cutoff", [-3.0]),
        ("sensors.torque_order", [0, 5]),
        ("actuators.lag", [INF, -1.0]),
        ("voluntary.rms", [-0.5, NAN]),
        ("voluntary.cutoff", [0.0, 500.0]),
        ("substeps", [0]),
        ("watchdog_ticks", [0, 101]),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_and_named(name: str, values: list[Any]) -> None:
    for value in values:
        group, _, short = name.rpartition(".")
        with pytest.raises(ConfigurationError, match=f"{short}|{group}:|step") as caught:
            SimulatedRig(build(SimulatorParameters, {**PRESET, name: value}))
        assert "\n" not in str(caught.value)
