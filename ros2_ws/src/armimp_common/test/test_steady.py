"""Time that nobody can set: timers, spinning, and the refusal of simulated time."""

import ast
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from rosgraph_msgs.msg import Clock

from armimp_common.executor import Spinner
from armimp_common.parameters import ParameterSet
from armimp_common.schema import Schema
from support.graph import CLOCK_STEPS, PATIENCE, eventually, set_clock

SOURCES = Path(__file__).parents[2]

WALL_CLOCK = {
    "create_timer",
    "create_rate",
    "get_clock",
    "ROSClock",
    "time.time",
    "time.time_ns",
    "time.localtime",
    "time.gmtime",
    "time.strftime",
    "datetime.now",
    "datetime.today",
    "datetime.utcnow",
    "CLOCK_REALTIME",
}
"""Names of what reads a clock that can be set, or waits by one."""

PERMITTED = {
    ("armimp_common/executor.py", "create_timer"): "on the steady clock",
    ("armimp_common/executor.py", "time.time"): "to find out that it was set",
    ("armimp_common/driver_base.py", "get_clock"): "stamps of reports, for people",
    ("armimp_bringup/cli.py", "datetime.now"): "name of the output directory",
    ("armimp_estimation/summary.py", "datetime.now"): "date of a result, for people",
}


class Settings(Schema):
    gain: float = 1.0


@pytest.mark.parametrize("step", CLOCK_STEPS)
@pytest.mark.timeout(60)
def test_when_the_clock_is_set_expect_stop_conditions_of_a_busy_node_to_be_looked_at(
    node: Node, step: float
) -> None:
    publisher = node.create_publisher(Clock, "echo", 10)
    echoes: list[Clock] = []

    def echo(message: Clock) -> None:
        echoes.append(message)
        publisher.publish(message)

    node.create_subscription(Clock, "echo", echo, 10)
    publisher.publish(Clock())
    with Spinner([node]) as spinner:
        eventually(spinner, lambda: len(echoes) > 2, "echoes")
        set_clock(node, step)
        assert not spinner.spin_until(Future(), 0.1)
        begun = time.monotonic()
        spinner.spin(lambda: time.monotonic() > begun + 0.1)

    assert time.monotonic() - begun < PATIENCE


def test_when_simulated_time_is_set_later_expect_a_refusal_and_the_clock_as_it_was(
    node: Node,
) -> None:
    ParameterSet(node, Settings)
    with Spinner([node]):
        pass

    for setting in (
        node.set_parameters([Parameter("use_sim_time", value=True)])[0],
        node.set_parameters_atomically(
            [Parameter("gain", value=2.0), Parameter("use_sim_time", value=True)]
        ),
    ):
        assert not setting.successful
        assert "cannot be true: watchdogs" in setting.reason
    assert node.get_parameter("use_sim_time").value is False
    assert node.get_parameter("gain").value == 1.0
    clock: Any = node.get_clock()
    assert not clock.ros_time_is_active
    assert node.set_parameters([Parameter("use_sim_time", value=False)])[0].successful


def names_in(tree: ast.AST) -> Iterator[str]:
    """Names that are used, and the last two parts of dotted ones; imported ones, too."""
    for part in ast.walk(tree):
        if isinstance(part, ast.Name):
            yield part.id
        elif isinstance(part, ast.Attribute):
            yield part.attr
            yield f"{ast.unparse(part.value).rpartition('.')[2]}.{part.attr}"
        elif isinstance(part, ast.ImportFrom):
            yield from (f"{part.module}.{alias.name}" for alias in part.names)


def test_nothing_else_reads_a_clock_that_can_be_set() -> None:
    found = {
        ("/".join(path.parts[-2:]), name)
        for path in SOURCES.glob("armimp_*/armimp_*/**/*.py")
        for name in WALL_CLOCK.intersection(names_in(ast.parse(path.read_text("utf-8"))))
    }
    assert found == set(PERMITTED)
