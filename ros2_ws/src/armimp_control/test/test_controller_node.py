"""The controller node over real DDS: answers, faults, watchdog, parameters, life cycle."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from armimp_common import qos, topics
from armimp_common.executor import Spinner
from armimp_common.schema import Value
from armimp_common.status import Level, Phase, to_time, values_of
from armimp_common.topics import PERIOD_NS
from armimp_control.node import ImbicControllerNode
from armimp_control.safety_limiter import SafetyParameters
from support.controller import (
    FAILURE,
    NAMES,
    POSTURE,
    SUCCESS,
    ask,
    controller_parameters,
    wobble,
)
from support.graph import (
    CLOCK_STEPS,
    HandedClock,
    Launch,
    ScriptedDriver,
    a_moment,
    eventually,
    set_clock,
)

SETTLE, PERTURB, REST = 50, 100, 50
START = 5_000_000_000
# So patient that no test sees the watchdog by accident.
PARAMETERS = controller_parameters(
    SETTLE, PERTURB, REST, safety=SafetyParameters(slowest_tick=10.0)
)
IMPATIENT: dict[str, Value] = {"safety.slowest_tick": 0.06, "safety.watchdog_ticks": 5}


MakeController = Callable[..., ImbicControllerNode]


@pytest.fixture
def make(launch: Launch) -> MakeController:
    return lambda *changes: launch(ImbicControllerNode, PARAMETERS, *changes)


@pytest.fixture
def driver(node: Node) -> ScriptedDriver:
    return ScriptedDriver(node, NAMES, start_ns=START)


def bring_up(controller: ImbicControllerNode, driver: ScriptedDriver) -> None:
    assert controller.trigger_configure() is SUCCESS
    assert controller.trigger_activate() is SUCCESS, controller.transition_error
    driver.wait_for_controller()


def start(controller: ImbicControllerNode, driver: ScriptedDriver, spinner: Spinner) -> None:
    """Bring a controller up, and have it command torque."""
    bring_up(controller, driver)
    for theta, tau_h in wobble(60):
        driver.feed(theta, tau_h)
    eventually(spinner, lambda: driver.answered, "an answer to every sample")
    assert driver.commands[-1] != (0.0, 0.0)


def feed_still(driver: ScriptedDriver, ticks: int) -> None:
    for _ in range(ticks):
        driver.feed(POSTURE, (0.0, 0.0))


def encoded(names: Sequence[str], values: Sequence[float], field: str = "position") -> bytes:
    message = JointState(name=list(names), **{field: list(values)})
    message.header.stamp = to_time(START + 60 * PERIOD_NS)
    data: bytes = serialize_message(message)
    return data


MALFORMED = {
    "truncated": encoded(NAMES, POSTURE)[:-30],
    "empty": b"",
    "a joint missing": encoded(("shoulder",), (1.0,)),
    "unknown joint": encoded(("shoulder", "wrist"), POSTURE),
    "one joint twice": encoded(("shoulder", "shoulder"), POSTURE),
    "too many joints": encoded((*NAMES, "wrist"), (*POSTURE, 0.0)),
    "no values": encoded(NAMES, (0.0, 0.0), "effort"),
}


class TestFaults:
    @pytest.mark.parametrize("topic", [topics.JOINT_STATES, topics.TORQUE_SENSORS])
    @pytest.mark.parametrize("message", MALFORMED.values(), ids=MALFORMED.keys())
    def test_when_a_sample_is_malformed_expect_zero_torque_and_an_abort(
        self,
        make: MakeController,
        driver: ScriptedDriver,
        spinner: Spinner,
        topic: str,
        message: bytes,
    ) -> None:
        if message == MALFORMED["no values"] and topic == topics.TORQUE_SENSORS:
            message = encoded(NAMES, (0.0, 0.0))
        start(make(), driver, spinner)

        driver.channels[topic].publisher.publish(message)
        eventually(
            spinner,
            lambda: driver.has_said(Phase.ABORTED) and len(driver.commands) > 60,
            "an abort",
        )

        assert driver.commands[60:] == [(0.0, 0.0)]
        assert driver.messages[-1].level == bytes([Level.ERROR])
        assert driver.statuses[-1].reason.startswith("malformed sensor message: JointState")
        assert "\n" not in driver.statuses[-1].reason
        feed_still(driver, 10)
        eventually(spinner, lambda: driver.answered, "an answer to every sample")
        assert set(driver.commands[60:]) == {(0.0, 0.0)}
        assert {values for _, values in driver.perturbations[60:]} == {(0.0, 0.0)}

    @pytest.mark.parametrize(
        ("topic", "what"),
        [(topics.JOINT_STATES, "position"), (topics.TORQUE_SENSORS, "torque reading")],
    )
    def test_when_a_reading_without_a_partner_is_not_finite_expect_zero_torque_at_once(
        self, make: MakeController, driver: ScriptedDriver, spinner: Spinner, topic: str, what: str
    ) -> None:
        start(make(), driver, spinner)

        for _ in range(3):
            driver.channels[topic].publish(driver.stamp_ns + 10**15, (math.nan, 1.0))
        eventually(
            spinner,
            lambda: driver.has_said(Phase.ABORTED) and len(driver.commands) > 60,
            "an abort",
        )
        a_moment(spinner)

        # One is enough: in lockstep each is a step.
        assert driver.commands[60:] == [(0.0, 0.0)]
        assert driver.statuses[-1].phase is Phase.ABORTED
        assert driver.statuses[-1].reason == f"{what} of joint 1 is not finite: nan"
        feed_still(driver, 3)
        eventually(spinner, lambda: len(driver.commands) >= 64, "an answer to every sample")
        assert set(driver.commands[60:]) == {(0.0, 0.0)}

    @pytest.mark.parametrize("clock_step", [None, *CLOCK_STEPS])
    def test_when_samples_stay_away_expect_the_torque_ramped_to_zero_and_an_abort(
        self,
        make: MakeController,
        driver: ScriptedDriver,
        spinner: Spinner,
        clock: HandedClock,
        clock_step: float | None,
    ) -> None:
        controller = make({**IMPATIENT, "safety.ramp_time": 0.05})
        start(controller, driver, spinner)
        if clock_step is not None:
            set_clock(controller, clock_step)

        last = np.abs(driver.commands[59])
        a_moment(spinner)
        assert len(driver.commands) == 60
        clock.pace = 0.005
        eventually(
            spinner,
            lambda: driver.has_said(Phase.ABORTED) and driver.commands[-1] == (0.0, 0.0),
            "zero torque",
        )
        a_moment(spinner)

        ramp = np.array([last, *np.abs(driver.commands[60:])])
        assert (np.diff(ramp, axis=0) <= 0.0).all()
        assert len(np.unique(ramp)) > 5
        assert driver.commands[-1] == (0.0, 0.0)
        assert driver.statuses[-1].reason == "no sensor sample arrived any more"


Ask = Callable[[], tuple[bool, str]]


@pytest.fixture
def emergency_stop(node: Node, spinner: Spinner) -> Ask:
    return partial(ask, node, spinner, topics.CONTROLLER_STOP_SERVICE)


@pytest.fixture
def reset(node: Node, spinner: Spinner) -> Ask:
    return partial(ask, node, spinner, topics.CONTROLLER_RESET_SERVICE)


class TestServices:
    def test_emergency_stop_takes_the_torque_away_at_once_and_for_good(
        self,
        make: MakeController,
        driver: ScriptedDriver,
        spinner: Spinner,
        emergency_stop: Ask,
        reset: Ask,
    ) -> None:
        controller = make()
        start(controller, driver, spinner)

        success, message = emergency_stop()
        eventually(spinner, lambda: driver.has_said(Phase.ABORTED), "an abort")

        assert success
        assert message == "no torque until imbic_controller/reset is called"
        assert driver.commands[60:] == [(0.0, 0.0)]
        assert driver.statuses[-1].reason == "emergency stop"
        feed_still(driver, 20)
        eventually(spinner, lambda: driver.answered, "an answer to every sample")
        assert controller.trigger_deactivate() is SUCCESS
        assert controller.trigger_activate() is FAILURE
        assert controller.transition_error == (
            "a fault is latched: emergency stop; call imbic_controller/reset first"
        )
        assert controller.trigger_cleanup() is SUCCESS
        assert controller.trigger_configure() is SUCCESS
        assert controller.trigger_activate() is FAILURE
        assert set(driver.commands[60:]) == {(0.0, 0.0)}

        assert reset() == (
            True,
            "reset: emergency stop; the next activation begins a new experiment",
        )
        assert controller.trigger_activate() is SUCCESS, controller.transition_error

    @pytest.mark.parametrize(
        ("theta", "reason"),
        [
            ((POSTURE[0] + 0.6, POSTURE[1]), "joint 1 is 0.6 rad away from the posture"),
            ((POSTURE[0], math.nan), "position of joint 2 is not finite: nan"),
        ],
    )
    def test_while_the_cause_persists_expect_reset_refused(
        self,
        make: MakeController,
        driver: ScriptedDriver,
        spinner: Spinner,
        reset: Ask,
        theta: tuple[float, float],
        reason: str,
    ) -> None:
        start(make(), driver, spinner)
        for _ in range(20):
            driver.feed(theta, (0.0, 0.0))
        eventually(spinner, lambda: driver.answered, "an answer to every sample")
        assert driver.commands[-1] == (0.0, 0.0)

        success, message = reset()
        assert not success
        assert message.startswith(f"not reset: the cause persists: {reason}")

        feed_still(driver, 20)
        eventually(spinner, lambda: driver.answered, "an answer to every sample")
        success, message = reset()
        assert success
        assert message.startswith(f"reset: {reason}")
        assert reset() == (True, "there was no fault")


class TestDiagnostics:
    def test_clips_and_fault_go_out_at_a_low_rate_and_at_once_on_a_fault(
        self, make: MakeController, driver: ScriptedDriver, spinner: Spinner, node: Node
    ) -> None:
        heard: list[DiagnosticStatus] = []

        def hear(message: DiagnosticArray) -> None:
            heard.extend(message.status)

        node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, hear, qos.DIAGNOSTICS)
        bring_up(make({"safety.torque_limit": 1e-3, "sequence.duration": 2.0}), driver)
        samples = wobble(1010)
        for start in range(0, 1010, 101):
            for theta, tau_h in samples[start : start + 101]:
                driver.feed(theta, tau_h)
            eventually(spinner, lambda: driver.answered, "an answer to every sample")
        eventually(spinner, lambda: len(heard) == 1, "diagnostics")
        values = values_of(heard[0])
        assert (heard[0].name, heard[0].level) == (
            "imbic_controller: safety limiter",
            bytes([Level.WARN]),
        )
        assert heard[0].message == "commands were clipped"
        assert values["tick"] == "1000"
        commands = np.array(driver.commands[:1000])
        # All joints get less if one does.
        clipped = np.count_nonzero(commands[np.any(np.abs(commands) == 1e-3, axis=1)])
        assert values["clipped_torque"] == str(clipped)
        assert {key: value for key, value in values.items() if value == "0"}.keys() == {
            *("clipped_position", "clipped_velocity", "clipped_rate", "clipped_power")
        }

        driver.feed((math.nan, 0.0), (0.0, 0.0))
        eventually(spinner, lambda: len(heard) == 2, "diagnostics of the fault")
        assert heard[1].level == bytes([Level.ERROR])
        assert heard[1].message == values_of(heard[1])["fault"]
        assert heard[1].message == "position of joint 1 is not finite: nan"
        eventually(spinner, lambda: driver.has_said(Phase.ABORTED), "an abort")
        commands = np.array(driver.commands[SETTLE:1010])
        in_trial = np.count_nonzero(commands[np.any(np.abs(commands) == 1e-3, axis=1)])
        assert driver.statuses[-1].clipped == in_trial > 0


class TestParameters:
    def test_while_active_changes_are_refused_with_a_reason(
        self, make: MakeController, driver: ScriptedDriver
    ) -> None:
        controller = make()
        bring_up(controller, driver)
        change = Parameter("law.gamma", value=50.0)

        (result,) = controller.set_parameters([change])
        assert not result.successful
        assert result.reason == "law.gamma cannot be changed now: a trial is running"
        assert controller.get_parameter("law.gamma").value == 100.0

        controller.trigger_deactivate()
        (result,) = controller.set_parameters([change])
        assert result.successful


class TestLife:
    @pytest.mark.parametrize("how", ["trigger_shutdown", "destroy_node"])
    def test_when_ended_during_a_trial_expect_zero_torque_and_an_abort(
        self, make: MakeController, driver: ScriptedDriver, spinner: Spinner, how: str
    ) -> None:
        controller = make()
        start(controller, driver, spinner)

        getattr(controller, how)()

        eventually(
            spinner,
            lambda: driver.has_said(Phase.ABORTED) and len(driver.commands) == 61,
            "an abort",
        )
        assert driver.commands[-1] == (0.0, 0.0)
