"""The controller and its surroundings: it ends the experiment when one of them is lost."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import UInt64

from armimp_common import heartbeat, qos, topics
from armimp_common.executor import Spinner
from armimp_common.schema import Value
from armimp_common.status import Phase
from armimp_common.topics import ESTIMATOR_NODE, SIM_NODE, SUPERVISOR_NODE
from armimp_control.node import ImbicControllerNode
from support.controller import (
    NAMES,
    POSTURE,
    SUCCESS,
    active_controller,
    controller_parameters,
)
from support.graph import HandedClock, Launch, ScriptedDriver, a_moment, eventually, report

OFF = (POSTURE[0] + 1e-4, POSTURE[1])


class Surroundings:
    """Stands for rig and recorder, with a controller under torque between them."""

    def __init__(self, node: Node, spinner: Spinner, launch: Launch, mode: str) -> None:
        self.spinner = spinner
        self.driver = ScriptedDriver(node, NAMES)
        self.received: Publisher = node.create_publisher(UInt64, topics.RECEIVED, qos.LATCHED)
        # So patient in lockstep that no test sees the watchdog.
        changes: dict[str, Value] = {
            "mode": mode,
            "safety.slowest_tick": 10.0,
            "safety.watchdog_ticks": 100,
        }
        self.controller: ImbicControllerNode = launch(
            ImbicControllerNode, controller_parameters(), changes
        )
        assert self.controller.trigger_configure() is SUCCESS, self.controller.transition_error

    def activate(self) -> None:
        assert self.controller.trigger_activate() is SUCCESS, self.controller.transition_error
        self.driver.wait_for_controller()
        for _ in range(3):
            self.driver.feed(OFF)
            self.driver.await_answers(self.spinner)
        assert any(self.driver.commands[-1])

    @property
    def monitors(self) -> list[heartbeat.HeartbeatMonitor]:
        return [*self.controller._partners, self.controller._supervisor]

    def heard(self, name: str, *, alive: int, silent: int) -> None:
        (monitor,) = (one for one in self.monitors if one.name == name)
        report(monitor, alive=alive, silent=silent)

    def aborted(self) -> bool:
        return self.driver.has_said(Phase.ABORTED)

    def assert_aborted(self, reason: str) -> None:
        assert self.driver.await_phase(Phase.ABORTED, self.spinner).reason == reason
        eventually(self.spinner, lambda: not any(self.driver.commands[-1]), "zero torque")
        self.driver.feed(OFF)
        self.driver.await_answers(self.spinner)
        assert not any(self.driver.commands[-1])


@pytest.fixture
def mode() -> str:
    return "lockstep"


@pytest.fixture
def around(node: Node, spinner: Spinner, launch: Launch, mode: str) -> Surroundings:
    return Surroundings(node, spinner, launch, mode)


SILENCE = "gave no sign of life for 6 s: it is dead or stopped"


@pytest.mark.parametrize(
    ("name", "borne", "lost", "how"),
    [
        (SIM_NODE, 0, 1, SILENCE),
        (SIM_NODE, 0, 0, "has left"),
        # Orchestrator and recorder may be silent in lockstep, until they are dead.
        (SUPERVISOR_NODE, 1, 0, "is dead"),
        (ESTIMATOR_NODE, 1, 0, "is dead"),
    ],
)
def test_when_another_node_is_lost_expect_zero_torque_but_patience_with_those_that_may_be_silent(
    around: Surroundings, name: str, borne: int, lost: int, how: str
) -> None:
    around.activate()
    around.heard(name, alive=1, silent=0)
    if borne:
        around.heard(name, alive=0, silent=borne)
    a_moment(around.spinner)
    assert not around.aborted()

    around.heard(name, alive=0, silent=lost)

    around.assert_aborted(f"{name} {how}")


def test_when_this_process_was_held_up_expect_no_torque_for_a_rig_that_has_died_meanwhile(
    around: Surroundings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heartbeat, "state_of", lambda _: "R")
    around.activate()
    around.heard(SIM_NODE, alive=1, silent=0)
    monkeypatch.setattr(heartbeat, "state_of", lambda _: "")
    # Nothing but the sample finds out: it waits before the timers of the monitors.
    for monitor in around.monitors:
        monitor._timer.cancel()
        monitor.checked -= 0.1

    commands = len(around.driver.commands)
    around.driver.feed(OFF)
    eventually(around.spinner, lambda: len(around.driver.commands) > commands, "a command")

    assert not np.any(around.driver.commands[commands:])
    aborted = around.driver.await_phase(Phase.ABORTED, around.spinner)
    assert aborted.reason == f"{SIM_NODE} is dead"


@pytest.mark.parametrize("mode", ["realtime"])
@pytest.mark.parametrize("name", [ESTIMATOR_NODE, SIM_NODE])
def test_when_rig_or_recorder_falls_silent_in_real_time_expect_zero_torque(
    around: Surroundings, name: str
) -> None:
    # Before the first sample, so that no watchdog over samples comes first.
    assert around.controller.trigger_activate() is SUCCESS, around.controller.transition_error
    around.driver.wait_for_controller()
    around.heard(name, alive=1, silent=0)

    around.heard(name, alive=0, silent=1)

    around.assert_aborted(f"{name} {SILENCE}")


def test_when_the_recorder_takes_leave_expect_zero_torque(around: Surroundings) -> None:
    around.activate()
    around.received.publish(UInt64(data=0))
    a_moment(around.spinner)
    assert not around.aborted()

    around.received.publish(UInt64(data=topics.RECORDER_GONE))

    around.assert_aborted("nothing is recorded any more")


def test_when_a_sample_comes_after_a_stall_before_anyone_looked_expect_an_abort_all_the_same(
    node: Node, launch: Launch, spinner: Spinner, clock: HandedClock
) -> None:
    driver = ScriptedDriver(node, NAMES)
    parameters = controller_parameters(300, 200, 300)
    controller = active_controller(launch, driver, parameters, {"mode": "realtime"})
    driver.feed(OFF, ticks=20)
    driver.await_answers(spinner)
    assert any(command != (0.0, 0.0) for command in driver.commands)

    # Nothing is spun: the process is held up, and finds timer and sample waiting afterwards.
    clock.now += 0.02
    controller._on_reading(0, driver.stamp_ns, OFF)
    controller._on_reading(1, driver.stamp_ns, (0.0, 0.0))

    aborted = driver.await_phase(Phase.ABORTED, spinner)
    assert aborted.reason == "no sensor sample arrived any more"
