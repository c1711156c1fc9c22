"""The node of the template with a device that fails."""

import time
from collections.abc import Iterator, Sequence

import pytest
from rclpy.node import Node

from armimp_common.executor import Spinner
from armimp_driver_template import node as template
from armimp_driver_template.device import Frame
from armimp_driver_template.node import ExoDriver
from armimp_driver_template.parameters import DriverParameters
from support.controller import ScriptedController
from support.graph import Launch

PUSH, ZERO = (5.0, 0.0), (0.0, 0.0)


class FailingDevice:
    """Sends a frame for each answer until it fails, and keeps a clock of its own.

    The clock advances by the timeouts of a silent device, so the machine's load does not matter.
    """

    paced = True
    names = DriverParameters().names_at_device()

    def __init__(self) -> None:
        self.silent = self.broken = self.closed = False
        self.sent: list[tuple[float, tuple[float, ...]]] = []
        self.silence = 0.0
        self._counter, self._answers = -1, 0

    def open(self) -> None:
        self._counter, self._answers = -1, 0

    def close(self) -> None:
        self.closed = True

    def receive(self, timeout: float) -> Frame | None:
        if self.silent:
            time.sleep(timeout)
            self.silence += timeout
            return None
        for _ in range(500):
            time.sleep(0.001)
            if self._answers > self._counter:
                break
        self._counter += 1
        return Frame(self._counter, (60000, 60000), (1250, -400))

    def send(self, torque: Sequence[float]) -> None:
        self._answers += 1
        if self.broken:
            raise OSError("no buffer space available")
        self.sent.append((self.silence, tuple(torque)))


class World(ScriptedController):
    """A driver with such a device, and a controller that answers each of its samples."""

    def __init__(self, node: Node, spinner: Spinner, device: FailingDevice) -> None:
        super().__init__(node, spinner)
        self.device, self.answer = device, ZERO

    def push(self) -> None:
        self.answer = PUSH
        self.until(lambda: bool(self.device.sent) and self.device.sent[-1][1] == PUSH, "torque")


@pytest.fixture
def world(
    node: Node, spinner: Spinner, launch: Launch, monkeypatch: pytest.MonkeyPatch
) -> Iterator[World]:
    device = FailingDevice()
    monkeypatch.setattr(template, "make_device", lambda parameters: device)
    driver = launch(ExoDriver, DriverParameters())
    world = World(node, spinner, device)
    world.bring_up(driver)
    yield world
    driver.destroy_node()
    assert device.closed


def test_when_the_bus_is_silent_expect_zero_torque_within_200_milliseconds(world: World) -> None:
    world.push()
    world.device.silent = True
    world.until(lambda: world.device.sent[-1][1] == ZERO, "zero torque")
    gone = min(when for when, torque in world.device.sent if when > 0.0 and torque == ZERO)
    assert gone < 0.2
    world.await_fault("nothing for 5 periods")


def test_when_the_bus_takes_no_commands_expect_a_fault_and_a_node_that_lives(world: World) -> None:
    world.push()
    world.device.broken = True
    world.await_fault("no buffer space")
    world.device.broken = False
    # It gets zero torque as soon as it listens again, and nothing else before a reset.
    count = len(world.device.sent)
    world.until(lambda: len(world.device.sent) > count + 20, "commands")
    assert {torque for _, torque in world.device.sent[count:]} == {ZERO}
