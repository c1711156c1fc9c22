"""What the orchestrator hears of an experiment, and until when."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from armimp_bringup.graph import GraphContext
from armimp_bringup.supervisor import Supervisor
from armimp_common import contract, qos
from armimp_common.diagnostics import (
    Level,
    make_array,
    make_status,
    timing_status,
    trial_status_message,
)
from armimp_common.jitter import TimingFigures
from armimp_common.spin import Spinner
from armimp_common.trial_status import Phase, TrialStatus
from support.graph import PATIENCE

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
        trial = rig.create_publisher(DiagnosticStatus, contract.TRIAL, qos.LATCHED)
        diagnostics = rig.create_publisher(DiagnosticArray, contract.DIAGNOSTICS, qos.DIAGNOSTICS)

        def report(ticks: int) -> None:
            fault = make_status("arm_sim: rig", Level.ERROR, f"fault at {ticks}", {})
            timing = timing_status(TimingFigures(ticks=ticks, late=0, missed=0))
            diagnostics.publish(make_array(0, [timing, fault]))

        with Spinner([supervisor, rig]) as spinner:

            def until(condition: Callable[[], bool]) -> None:
                end = time.monotonic() + PATIENCE
                spinner.spin(lambda: condition() or time.monotonic() > end, period=0.02)
                assert condition()

            until(lambda: diagnostics.get_subscription_count() == 1)
            if told_before:
                report(1000)
                until(lambda: len(supervisor.problems) == 1)
            trial.publish(trial_status_message(STATUS))
            until(lambda: supervisor.finished)
            for ticks in (1600, 1700):
                report(ticks)
            until(lambda: supervisor.problems[-1:] == ["arm_sim: rig: fault at 1700"])
        for node in (rig, supervisor):
            node.destroy_node()

    assert supervisor.timing is not None
    assert supervisor.timing.ticks == (1000 if told_before else 1600)
