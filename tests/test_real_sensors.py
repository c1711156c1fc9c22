"""The experiment with sensors and drives of a real rig, without ROS: what calibration is worth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import node_parameters
from armimp_estimation.metadata import Metadata
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming


def test_the_estimator_knows_what_is_simulated_unless_it_is_told_otherwise() -> None:
    sensors = {"sensors": {"torque": {"delay": 0.0015, "cutoff": 150.0, "order": 2}}}
    # Slow enough for a loop that is told of readings as late as that.
    slow = {"target": {"lock_frequency": 50.0}, "law": {"gamma": 50.0}}
    values = {
        "arm_sim": {**sensors, "actuators": {"bandwidth": 800.0}},
        "imbic_controller": slow,
    }

    def known(**more: Any) -> TorqueReading:
        config = ExperimentConfig.model_validate({**values, **more})
        return Metadata.of(node_parameters(config, None).estimator.bag_metadata()).reading

    prompt = TorqueReading(timing=TorqueTiming.BEFORE_UPDATE)
    everything = TorqueReading(
        timing=prompt.timing,
        delay=0.0015,
        cutoff=150.0,
        order=2,
        actuator_lag=1.0 / (2.0 * np.pi * 800.0),
    )
    assert known() == everything
    assert known(torque_delay=0.001) == everything.model_copy(update={"delay": 0.001})
    assert known(torque_delay=0.0) == everything.model_copy(update={"delay": 0.0})
    blind = {"torque": {"delay": 0.0, "cutoff": 0.0, "actuator_lag": 0.0}}
    assert known(impedance_estimator=blind) == prompt


@pytest.mark.parametrize("joints", [1, pytest.param(7, marks=pytest.mark.slow)])
def test_the_realistic_rig_can_be_simulated_and_controlled_with_any_number_of_joints(
    joints: int,
) -> None:
    values = {"rig": "realistic", "internal_model": "observer", "joints": joints}
    case = node_parameters(ExperimentConfig.model_validate(values), None)
    assert case.simulator.soft
    case.controller.check()
