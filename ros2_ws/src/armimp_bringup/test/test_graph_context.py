"""The context of a graph: domain, environment, and what the orchestrator hears in it."""

import os
import socket
import subprocess
from pathlib import Path
from unittest.mock import Mock

import pytest
from rclpy.node import Node

from armimp_bringup import graph as domain
from armimp_bringup.graph import LOOPBACK, OPEN, DomainClaim, GraphContext
from armimp_bringup.nodes import SeparateNodes
from armimp_bringup.orchestrator import Supervisor
from armimp_common import topics
from armimp_common.errors import GraphError
from armimp_common.executor import Spinner
from armimp_common.process import ParentWatchdog
from armimp_common.pubsub import create_publisher
from armimp_common.status import (
    Level,
    Phase,
    Progress,
    make_array,
    make_status,
    status_message,
)
from support.graph import CHOICES, eventually
from support.processes import run_python
from support.streams import trial_status


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
    given = {CHOICES[0]: reach, CHOICES[1]: None if profiles is None else str(profiles)}
    for name, value in given.items():
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)

    with GraphContext():
        assert os.environ[CHOICES[0]] == expected[0]
        assert os.environ[CHOICES[1]] == str(expected[1])

    assert {name: os.environ.get(name) for name in given} == given


OPEN_BEFORE = """
import os, rclpy
from armimp_bringup.graph import GraphContext
from psutil import Process
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
rclpy.init(domain_id={domain})
rclpy.create_node("before").destroy_node()
rclpy.shutdown()
del os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"]
with GraphContext() as graph:
    node = rclpy.create_node("after", context=graph.context)
    print("ports", graph.claim.domain_id, *(one.laddr.port for one in Process().net_connections()))
    print("variable", os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"])
    node.destroy_node()
"""


def test_when_the_process_was_in_a_graph_before_expect_it_to_find_the_local_host_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in CHOICES:
        monkeypatch.delenv(name, raising=False)

    with DomainClaim() as claim:
        printed = run_python("-c", OPEN_BEFORE.format(domain=claim.domain_id))

    ports, variable = printed.splitlines()
    domain, *found = (int(port) for port in ports.split()[1:])
    # A domain begins with its multicast port; its other ports follow.
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
    for name in CHOICES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)

    maps = run_python("-c", IN_A_GRAPH)

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


# --- Domains are claimed so that experiments do not meet, and no user keeps others out ----------


def test_when_two_claim_domains_expect_different_ones() -> None:
    with DomainClaim() as first, DomainClaim() as second:
        assert first.domain_id != second.domain_id
        assert {first.domain_id, second.domain_id} <= set(range(1, 101))


def test_when_a_program_of_another_kind_is_in_a_domain_expect_it_avoided() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other, DomainClaim() as first:
        free = first.domain_id
        other.bind(("0.0.0.0", 7400 + 250 * free + 10))
        first.close()
        assert free in set().union(*domain._occupied().values())


def test_when_one_user_holds_every_domain_expect_no_other_kept_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    me = os.getuid()
    everything = set(range(domain.LOWEST, domain.HIGHEST + 1))
    theirs, rest = everything - {7}, {7}
    monkeypatch.setattr(DomainClaim, "_take", _taken)
    monkeypatch.setattr(domain, "_occupied", lambda: {me + 1: theirs, me + 2: rest})
    with DomainClaim() as claim:
        assert claim.domain_id in theirs
    monkeypatch.setattr(DomainClaim, "_take", lambda claim, one: _taken(claim, one) or one == 50)
    with DomainClaim() as claim:
        assert claim.domain_id == 50, "its port is free"

    # One's own experiments are kept apart however many there are.
    monkeypatch.setattr(domain, "_occupied", lambda: {me: everything})
    with pytest.raises(GraphError, match="no domain id is free"):
        DomainClaim()


def _taken(claim: DomainClaim, domain_id: int) -> bool:
    claim.domain_id = domain_id
    return False


# --- What the orchestrator hears of an experiment, and until when -------------------------------


def test_faults_are_heard_after_an_abort_and_one_that_goes_on_replaces_what_it_was() -> None:
    with GraphContext() as graph:
        supervisor = Supervisor(graph, lambda _: None, realtime=True)
        rig = Node("rig", context=graph.context, use_global_arguments=False)
        trial = create_publisher(rig, topics.TRIAL)
        diagnostics = create_publisher(rig, topics.DIAGNOSTICS)

        def report(fault: str) -> None:
            status = make_status("arm_sim: rig", Level.ERROR, fault, {})
            diagnostics.publish(make_array(0, [status]))

        with Spinner([supervisor, rig]) as spinner:
            eventually(spinner, lambda: diagnostics.get_subscription_count() == 1, "a listener")
            report("no command")
            eventually(spinner, lambda: len(supervisor.faults) == 1, "the first fault")
            aborted = trial_status(phase=Phase.ABORTED, valid=False, reason="emergency stop")
            trial.publish(status_message(aborted))
            eventually(spinner, lambda: supervisor.finished, "the end")
            for fault in ("no command; published by /a", "emergency stop"):
                report(fault)
            heard = ["arm_sim: rig: no command; published by /a", "arm_sim: rig: emergency stop"]
            eventually(spinner, lambda: [*map(str, supervisor.faults)] == heard, "both")
        for node in (rig, supervisor):
            node.destroy_node()


def test_a_malformed_progress_message_does_not_end_the_orchestrator() -> None:
    told: list[Progress] = []
    progress = Progress(
        trial=1, trials=2, joint=1, phase=Phase.PERTURB, samples=100, planned=10_000, rate=1000.0
    )
    with GraphContext() as graph:
        supervisor = Supervisor(graph, told.append)
        other = Node("other", context=graph.context, use_global_arguments=False)
        channel = create_publisher(other, topics.PROGRESS)
        with Spinner([supervisor, other]) as spinner:
            eventually(spinner, lambda: channel.get_subscription_count() == 1, "a listener")
            channel.publish(b"\0\1\0\0rubbish")
            channel.publish(make_status("a stranger", Level.OK, "", {"trial": "x"}))
            channel.publish(status_message(progress))
            eventually(spinner, lambda: bool(told), "what can be read")
        for node in (other, supervisor):
            node.destroy_node()
    assert [progress.samples for progress in told] == [100]


def test_a_node_that_a_real_time_signal_killed_is_named(tmp_path: Path) -> None:
    nodes = object.__new__(SeparateNodes)
    with subprocess.Popen(["sleep", "60"]) as process:
        process.send_signal(40)
    (tmp_path / "log").write_text("begun\nsaid last\n")
    nodes.processes, nodes._logs = {"rig": process}, {"rig": tmp_path / "log"}
    assert nodes.dead() == {"rig": "node rig was killed by signal 40: said last"}


def test_a_process_that_cannot_be_ended_is_named_and_raises_nothing() -> None:
    immortal = Mock(pid=7, returncode=None)
    immortal.poll.return_value = None
    immortal.wait.side_effect = subprocess.TimeoutExpired("rig", 1.0)
    nodes = object.__new__(SeparateNodes)
    nodes._watchdog, nodes.processes = ParentWatchdog(), {"rig": immortal}
    assert nodes.close() == ["node rig could not be ended (process 7)"]
