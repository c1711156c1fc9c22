"""The controllers that the bridge expects are those of the parameter file that comes with it."""

from pathlib import Path
from typing import Any

import yaml

from armimp_common import topics
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_ros2_control.node import EFFORTS, STATES
from armimp_ros2_control.parameters import BridgeParameters

PATH = Path(__file__).resolve().parents[1] / "config" / "controllers.yaml"
FILE: dict[str, Any] = yaml.safe_load(PATH.read_text(encoding="utf-8"))


def parameters(node: str) -> dict[str, Any]:
    (only,) = FILE[node].items()
    assert only[0] == "ros__parameters"
    found: dict[str, Any] = only[1]
    return found


def test_the_rate_is_that_of_the_contract() -> None:
    assert parameters("controller_manager")["update_rate"] * PERIOD_NS == NS_PER_S


def test_names_of_the_controllers_make_the_topics_of_the_bridge_and_no_loop() -> None:
    broadcaster, _, states = STATES.partition("/")
    assert states == "joint_states"
    assert parameters(broadcaster)["use_local_topics"] is True
    forward, _, commands = EFFORTS.partition("/")
    assert commands == "commands"
    assert parameters(forward)["interface_name"] == "effort"
    assert {STATES, EFFORTS}.isdisjoint(topics.TOPICS)


def test_joints_are_in_the_order_of_the_bridge_and_effort_is_what_the_transducers_say() -> None:
    expected = list(BridgeParameters().joints)
    broadcaster = parameters(STATES.partition("/")[0])
    assert broadcaster["joints"] == expected
    assert parameters(EFFORTS.partition("/")[0])["joints"] == expected
    mapped = broadcaster["map_interface_to_joint_state"]
    assert mapped["effort"] in broadcaster["interfaces"]
    assert "effort" not in broadcaster["interfaces"]
