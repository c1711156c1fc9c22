"""Options of a user on rig and timing, and the node parameters that follow from them."""

from typing import Any

import numpy as np
import pytest
from pydantic import JsonValue

from armimp_bringup.config import ExperimentConfig, Overrides, load_config
from armimp_bringup.parameters import node_parameters
from armimp_common.errors import ConfigurationError
from armimp_estimation.metadata import Metadata
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming


@pytest.mark.parametrize(
    ("known", "gamma"),
    [({}, 100.0), ({"command_delay": 1}, 60.0), ({"arm_frequency": [6.5, 10.7]}, 100.0)],
)
def test_a_rig_that_is_known_to_lag_gets_the_slower_law_and_a_known_arm_does_not(
    known: dict[str, JsonValue], gamma: float
) -> None:
    config = ExperimentConfig(imbic_controller={"known": known})
    assert node_parameters(config, None).controller.law.gamma == gamma


def test_in_real_time_each_node_gets_a_process_and_options_of_single_nodes_prevail() -> None:
    overrides: Overrides = {"realtime": {"priority": 7}}
    config = load_config(None, {"mode": "realtime", "priority": 20, "arm_sim": overrides})
    assert config.processes == "separate"
    parameters = node_parameters(config, None)
    for node, priority in ((parameters.simulator, 7), (parameters.controller, 20)):
        assert (node.mode, node.realtime.priority) == ("realtime", priority)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"priority": 20}, "priority = 20 is for mode realtime"),
        (
            {"mode": "realtime", "imbic_controller": {"mode": "lockstep"}},
            "arm_sim: parameter 'mode' is 'realtime', that of imbic_controller 'lockstep'",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused_in_one_line(
    options: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(ConfigurationError, match=complaint) as caught:
        node_parameters(ExperimentConfig.model_validate(options), None)
    assert "\n" not in str(caught.value)


def test_the_estimator_knows_what_is_simulated_unless_it_is_told_otherwise() -> None:
    sensors = {"sensors": {"torque": {"delay": 0.0015, "cutoff": 150.0, "order": 2}}}
    # Slow enough for a loop that knows its readings to be that late.
    slow = {"target": {"lock_frequency": 50.0}, "law": {"gamma": 50.0}}
    values = {
        "arm_sim": {**sensors, "actuators": {"bandwidth": 800.0}},
        "imbic_controller": slow,
    }

    def known(**more: Any) -> TorqueReading:
        config = ExperimentConfig.model_validate({**values, **more})
        return Metadata.of(node_parameters(config, None).estimator.bag_metadata()).reading

    prompt = TorqueReading(timing=TorqueTiming.BEFORE_UPDATE, uncertainty=0.0)
    everything = TorqueReading(
        timing=prompt.timing,
        delay=0.0015,
        cutoff=150.0,
        order=2,
        actuator_lag=1.0 / (2.0 * np.pi * 800.0),
        uncertainty=0.0,
    )
    assert known() == everything
    assert known(torque_delay=0.001) == everything.model_copy(update={"delay": 0.001})
    assert known(torque_delay=0.0) == everything.model_copy(update={"delay": 0.0})
    blind = {"torque_delay": 0.0, "torque_cutoff": 0.0, "actuator_lag": 0.0}
    assert known(imbic_controller={**slow, "known": blind}) == prompt


@pytest.mark.parametrize("joints", [1, pytest.param(7, marks=pytest.mark.slow)])
def test_the_realistic_rig_can_be_simulated_and_controlled_with_any_number_of_joints(
    joints: int,
) -> None:
    values = {"rig": "realistic", "internal_model": "observer", "joints": joints}
    case = node_parameters(ExperimentConfig.model_validate(values), None)
    assert case.simulator.soft
    case.controller.check()
    assert Metadata.of(case.estimator.bag_metadata()).robot_of(joints) is not None


@pytest.mark.parametrize(("given", "share"), [("0", 0.0), ("2%", 0.02), ("0.02", 0.02)])
def test_a_target_error_is_a_share_or_none_at_all(given: str, share: float) -> None:
    assert ExperimentConfig.model_validate({"target_error": given}).target_error == share
