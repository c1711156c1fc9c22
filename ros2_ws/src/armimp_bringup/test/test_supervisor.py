"""What the orchestrator hears of an experiment, and until when."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from armimp_bringup.graph import GraphContext
from armimp_bringup.orchestrator import Supervisor
from armimp_common import qos, topics
from armimp_common.executor import Spinner
from armimp_common.status import (
    Level,
    Phase,
    Progress,
    TimingFigures,
    TrialStatus,
    make_array,
    make_status,
    status_message,
)
from support.graph import eventually

STATUS = TrialStatus(
    phase=Phase.ABORTED,
    trial=1,
    trials=2,
    joint=0,
    joint_name="shoulder",
    tick=0,
    start_ns=None,
    ticks=10_000,
    seed=1,
    valid=False,
    reason="emergency stop",
)


@pytest.mark.parametrize("told_before", [False, True])
def test_timing_counts_up_to_an_abort_and_faults_are_heard_after_it(told_before: bool) -> None:
    with GraphContext() as graph:
        supervisor = Supervisor(graph, lambda _: None)
        supervisor.realtime = True
        rig = Node("rig", context=graph.context, use_global_arguments=False)
        trial = rig.create_publisher(DiagnosticStatus, topics.TRIAL, qos.LATCHED)
        diagnostics = rig.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, qos.DIAGNOSTICS)

        def report(ticks: int) -> None:
            fault = make_status("arm_sim: rig", Level.ERROR, f"fault at {ticks}", {})
            timing = status_message(TimingFigures(ticks=ticks, late=0, missed=0))
            diagnostics.publish(make_array(0, [timing, fault]))

        with Spinner([supervisor, rig]) as spinner:
            eventually(spinner, lambda: diagnostics.get_subscription_count() == 1, "a listener")
            if told_before:
                report(1000)
                eventually(spinner, lambda: len(supervisor.faults) == 1, "the first fault")
            trial.publish(status_message(STATUS))
            eventually(spinner, lambda: supervisor.finished, "the end")
            for ticks in (1600, 1700):
                report(ticks)
            last = ["arm_sim: rig: fault at 1700"]
            eventually(spinner, lambda: [str(one) for one in supervisor.faults[-1:]] == last, "it")
        for node in (rig, supervisor):
            node.destroy_node()

    assert supervisor.timing is not None
    assert supervisor.timing.ticks == (1000 if told_before else 1600)


PROGRESS = {
    "trial": "1",
    "trials": "2",
    "joint": "1",
    "phase": "perturb",
    "samples": "100",
    "planned": "10000",
    "rate": "1000.0",
}


def test_a_malformed_progress_message_does_not_end_the_orchestrator() -> None:
    told: list[Progress] = []
    with GraphContext() as graph:
        supervisor = Supervisor(graph, told.append)
        other = Node("other", context=graph.context, use_global_arguments=False)
        channel = other.create_publisher(DiagnosticStatus, topics.PROGRESS, qos.PROGRESS)
        with Spinner([supervisor, other]) as spinner:
            eventually(spinner, lambda: channel.get_subscription_count() == 1, "a listener")
            channel.publish(b"\0\1\0\0rubbish")
            channel.publish(make_status("a stranger", Level.OK, "", {"trial": "x"}))
            channel.publish(make_status("a friend", Level.OK, "", PROGRESS))
            eventually(spinner, lambda: bool(told), "what can be read")
        for node in (other, supervisor):
            node.destroy_node()
    assert [progress.samples for progress in told] == [100]
