"""What a user says about time, and what the nodes make of it."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import JsonValue

from armimp_bringup.config import ExperimentConfig, Overrides, load_config
from armimp_bringup.parameters import node_parameters
from armimp_common.errors import ConfigurationError


def test_in_real_time_both_nodes_are_told_and_each_gets_a_process() -> None:
    config = load_config(None, {"mode": "realtime", "priority": 20})
    parameters = node_parameters(config, None)
    assert config.processes == "separate"
    for node in (parameters.simulator, parameters.controller):
        assert (node.mode, node.realtime.priority) == ("realtime", 20)


@pytest.mark.parametrize(
    ("known", "gamma"),
    [({}, 100.0), ({"command_delay": 1}, 60.0), ({"arm_frequency": [6.5, 10.7]}, 100.0)],
)
def test_a_rig_that_is_known_to_lag_gets_the_slower_law_and_a_known_arm_does_not(
    known: dict[str, JsonValue], gamma: float
) -> None:
    config = ExperimentConfig(imbic_controller={"known": known})
    assert node_parameters(config, None).controller.law.gamma == gamma


def test_parameters_of_single_nodes_prevail() -> None:
    overrides: Overrides = {"realtime": {"priority": 7}}
    config = ExperimentConfig(mode="realtime", priority=20, arm_sim=overrides)
    parameters = node_parameters(config, None)
    assert parameters.simulator.realtime.priority == 7
    assert parameters.controller.realtime.priority == 20


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
