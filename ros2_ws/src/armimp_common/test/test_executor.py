"""Spinning: stop conditions, errors in callbacks, signals, other processes."""

import os
import re
import signal
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Empty

from armimp_common import process
from armimp_common.errors import ArmimpError, ConfigurationError, GraphError
from armimp_common.executor import Spinner, run_node
from armimp_common.process import stop_on_signals
from support.graph import PATIENCE
from support.processes import run_python


class CallbackError(RuntimeError):
    pass


def boom(*arguments: object) -> None:
    raise CallbackError("in a callback")


def break_in_timer(node: Node) -> None:
    node.create_timer(0.01, boom)


def break_in_subscription(node: Node) -> None:
    node.create_subscription(Clock, "topic", boom, 10)
    publisher = node.create_publisher(Clock, "topic", 10)
    node.create_timer(0.01, lambda: publisher.publish(Clock()))


def break_in_service(node: Node) -> None:
    node.create_service(Empty, "service", boom)
    client = node.create_client(Empty, "service")
    assert client.wait_for_service(PATIENCE)
    client.call_async(Empty.Request())


@pytest.mark.parametrize(
    "arrange", [break_in_timer, break_in_subscription, break_in_service], ids=lambda f: f.__name__
)
def test_when_a_callback_raises_expect_it_at_the_caller(
    node: Node, arrange: Callable[[Node], None]
) -> None:
    arrange(node)

    end = time.monotonic() + PATIENCE
    with pytest.raises(CallbackError, match="in a callback"), Spinner([node]) as spinner:
        spinner.spin(lambda: time.monotonic() > end, period=0.01)


def test_a_second_interrupt_interrupts_unless_it_comes_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = signal.getsignal(signal.SIGINT)
    with stop_on_signals() as stopped:
        assert not stopped()
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)
            assert stopped()
        monkeypatch.setattr(process, "_IN_ORDER", 0.0)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == before


@pytest.mark.usefixtures("domain_id")
@pytest.mark.parametrize(("error", "status"), [(ConfigurationError, 2), (GraphError, 1)])
def test_when_the_node_cannot_be_made_expect_one_line_and_its_status(
    error: type[ArmimpError], status: int, capfd: pytest.CaptureFixture[str]
) -> None:
    def factory(*, context: Context) -> Node:
        raise error(f"bad value 3 {context.ok()}")

    assert run_node(factory, ["/some/where/program"]) == status
    assert capfd.readouterr().err == "program: bad value 3 True\n"


@pytest.mark.usefixtures("domain_id")
@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--bogus"], "unknown argument: '--bogus'"),
        (["--ros-args", "--bogus"], "--bogus"),
        (["--ros-args", "-p", "novalue"], "Couldn't parse parameter override rule: '-p novalue'"),
        (["--ros-args", "--params-file", "FILE"], "Sequence should be of same type"),
        (["--ros-args", "--params-file", "/does/not/exist.yaml"], "Error opening YAML file"),
    ],
)
def test_when_arguments_are_wrong_expect_status_2_and_one_line(
    arguments: list[str], reason: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mixed.yaml"
    path.write_text("counting:\n  ros__parameters:\n    array: [1, 2.5]\n")
    arguments = [str(path) if item == "FILE" else item for item in arguments]

    assert run_node(partial(Node, "counting"), ["program", *arguments]) == 2

    own = [line for line in capfd.readouterr().err.splitlines() if line.startswith("program: ")]
    assert len(own) == 1
    assert reason in own[0]
    assert not re.search(r" at /\S+:\d+", own[0]), "a place in the sources of ROS"


WATCHED = """
import os, pathlib, signal, sys
from rclpy.node import Node
from armimp_common.executor import run_node
class Watched(Node):
    def __init__(self, **kwargs):
        super().__init__("watched", **kwargs)
        print(pathlib.Path("/proc/self/maps").read_text())
        os.kill(os.getpid(), signal.SIGTERM)
sys.exit(run_node(Watched))
"""


@pytest.mark.parametrize(("chosen", "shared"), [(None, False), ("UDPv4", False), ("DEFAULT", True)])
def test_a_node_shares_no_memory_unless_the_user_wants_it(
    domain_id: int, chosen: str | None, shared: bool
) -> None:
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in {"FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"}
    }
    choice = {} if chosen is None else {"FASTDDS_BUILTIN_TRANSPORTS": chosen}

    maps = run_python("-c", WATCHED, env=kept | choice | {"ROS_DOMAIN_ID": str(domain_id)})

    assert "libfastrtps" in maps
    assert ("/dev/shm/fastrtps" in maps) == shared
