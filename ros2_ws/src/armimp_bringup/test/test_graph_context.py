"""The context of a graph: a domain of its own, and an environment that is given back."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from armimp_bringup.graph import LOOPBACK, OPEN, DomainClaim, GraphContext
from armimp_common.errors import GraphError

VARIABLES = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "ROS_DOMAIN_ID",
    "ROS_LOCALHOST_ONLY",
)


@pytest.mark.parametrize(
    ("reach", "profiles", "expected"),
    [
        ("LOCALHOST", None, ("SYSTEM_DEFAULT", LOOPBACK)),
        ("SUBNET", None, ("SUBNET", OPEN)),
        ("OFF", None, ("OFF", OPEN)),
        (None, OPEN, ("LOCALHOST", OPEN)),
        ("SUBNET", OPEN, ("SUBNET", OPEN)),
    ],
)
def test_when_the_user_chose_a_reach_or_a_profile_expect_it_kept(
    monkeypatch: pytest.MonkeyPatch,
    reach: str | None,
    profiles: Path | None,
    expected: tuple[str, Path],
) -> None:
    given = {VARIABLES[0]: reach, VARIABLES[1]: None if profiles is None else str(profiles)}
    for name, value in given.items():
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)

    with GraphContext():
        assert os.environ[VARIABLES[0]] == expected[0]
        assert os.environ[VARIABLES[1]] == str(expected[1])

    assert {name: os.environ.get(name) for name in given} == given


OPEN_BEFORE = """
import os, rclpy
from armimp_bringup.graph import GraphContext
from armimp_common.process import endpoints
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
rclpy.init(domain_id={domain})
rclpy.create_node("before").destroy_node()
rclpy.shutdown()
del os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"]
with GraphContext() as graph:
    node = rclpy.create_node("after", context=graph.context)
    print("ports", graph.claim.domain_id, *(one.port for one in endpoints()))
    print("variable", os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"])
    node.destroy_node()
"""


def test_when_the_process_was_in_a_graph_before_expect_it_to_find_the_local_host_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)

    with DomainClaim() as claim:
        done = subprocess.run(
            [sys.executable, "-c", OPEN_BEFORE.format(domain=claim.domain_id)],
            capture_output=True,
            text=True,
            check=False,
        )

    assert done.returncode == 0, done.stderr
    ports, variable = done.stdout.splitlines()
    domain, *found = (int(port) for port in ports.split()[1:])
    # The port of a domain for multicast; its others follow.
    assert found
    assert 7400 + 250 * domain not in found
    assert min(port for port in found if port >= 7400 + 250 * domain) < 7650 + 250 * domain
    # Other processes have read nothing yet.
    assert variable == "variable SYSTEM_DEFAULT"


IN_A_GRAPH = """
import pathlib, rclpy
from armimp_bringup.graph import GraphContext
with GraphContext() as graph:
    node = rclpy.create_node("inside", context=graph.context)
    print(pathlib.Path("/proc/self/maps").read_text())
    node.destroy_node()
"""


@pytest.mark.parametrize("reach", ["LOCALHOST", "SUBNET"])
def test_nothing_is_shared_in_memory_which_a_killed_process_could_leave_locked(
    monkeypatch: pytest.MonkeyPatch, reach: str
) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)

    maps = subprocess.run(
        [sys.executable, "-c", IN_A_GRAPH], capture_output=True, text=True, check=True
    ).stdout

    assert "libfastrtps" in maps
    assert "/dev/shm/fastrtps" not in maps


def test_when_security_is_enforced_without_a_keystore_expect_one_line_and_no_graph(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.delenv("ROS_SECURITY_KEYSTORE", raising=False)
    before = dict(os.environ)

    with pytest.raises(GraphError, match=r"^ROS cannot be started: ") as error:
        GraphContext()

    assert "\n" not in str(error.value)
    assert dict(os.environ) == before
