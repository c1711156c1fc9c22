"""What somebody else in the same domain can do to an experiment: end it, never spoil its result."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

from armimp_bringup import orchestrator
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import PARAMETERS_FILE, run_experiment
from armimp_common import qos, topics
from armimp_common.domain import DomainClaim
from armimp_common.lifecycle import LifecycleManager
from armimp_common.pubsub import CommandPublisher
from armimp_common.status import Phase, StoppingDecision, TrialStatus, status_message
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import Summary
from support.graph import PATIENCE

SHORT: dict[str, Any] = {"duration": 2.0}
pytestmark = pytest.mark.usefixtures("environment")
Act = Callable[[Node], object]


def disturbed(directory: Path, act: Act, **options: Any) -> Summary:
    """Run an experiment in which a stranger does something once, as the first trial begins."""
    with DomainClaim() as claim:
        domain_id = claim.domain_id
    stranger: list[Node] = []
    kept: list[object] = []

    def on_phase(phase: Phase) -> None:
        if phase is not Phase.PERTURB or stranger:
            return
        context = Context()
        rclpy.init(
            args=[],
            context=context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        stranger.append(Node("stranger", context=context, use_global_arguments=False))
        kept.append(act(stranger[0]))

    try:
        return run_experiment(
            ExperimentConfig.model_validate({**SHORT, **options}),
            directory,
            domain_id=domain_id,
            on_phase=on_phase,
        )
    finally:
        assert stranger
        stranger[0].context.try_shutdown()


def until_heard(publisher: Any, listeners: int) -> None:
    """Discovery goes on in threads of the middleware, so that nothing has to spin."""
    end = time.monotonic() + PATIENCE
    while publisher.get_subscription_count() < listeners and time.monotonic() < end:
        time.sleep(0.002)
    assert publisher.get_subscription_count() >= listeners


def unnumbered(node: Node, torque: float = 0.0) -> object:
    publisher = node.create_publisher(Float64MultiArray, topics.COMMANDS, qos.SAMPLE)
    until_heard(publisher, 2)
    publisher.publish(Float64MultiArray(data=[0.0, torque]))
    return publisher


def not_finite(node: Node) -> object:
    return unnumbered(node, torque=float("nan"))


def numbered(node: Node) -> object:
    channel = CommandPublisher(node, topics.COMMANDS, 2)
    until_heard(channel.publisher, 2)
    channel.publish((0.0, 0.0))
    return channel


def leaving(node: Node) -> None:
    channel = CommandPublisher(node, topics.COMMANDS, 2)
    until_heard(channel.publisher, 2)
    channel.publish((0.0, 0.0))
    assert channel.publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    node.destroy_publisher(channel.publisher)


@pytest.mark.parametrize(
    ("act", "processes", "who"),
    [
        pytest.param(unnumbered, "composed", "/stranger", marks=pytest.mark.slow),
        (not_finite, "composed", "/stranger"),
        pytest.param(numbered, "separate", "/stranger", marks=pytest.mark.slow),
        (leaving, "composed", "/imbic_controller"),
        pytest.param(unnumbered, "separate", "/stranger", marks=pytest.mark.slow),
        (numbered, "composed", "/stranger"),
    ],
)
def test_one_command_of_somebody_else_is_a_fault_with_who_and_when(
    tmp_path: Path, act: Act, processes: str, who: str
) -> None:
    summary = disturbed(tmp_path / "out", act, processes=processes)
    assert not summary.valid
    faults = [one.values for one in summary.problems if one.code is ProblemCode.NODE_FAULT]
    (fault,) = [str(one["reason"]) for one in faults if one["source"] == "arm_sim: rig"]
    assert topics.COMMANDS in fault
    when, _, publishers = fault.partition("; published by ")
    assert when.endswith(" s")
    assert who in publishers.split(", ")


def shortening(node: Node) -> None:
    publisher = node.create_publisher(DiagnosticStatus, topics.TRIAL, qos.LATCHED)
    until_heard(publisher, 2)
    publisher.publish(
        status_message(
            TrialStatus(
                phase=Phase.PERTURB,
                trial=1,
                trials=2,
                joint=0,
                joint_name="shoulder",
                tick=500,
                start_ns=500_000_000,
                ticks=1500,
                seed=1,
                valid=True,
            )
        )
    )


def test_a_status_that_ends_a_trial_early_is_refused_and_spoils_the_result(tmp_path: Path) -> None:
    summary = disturbed(tmp_path / "out", shortening)
    assert not summary.valid
    assert [trial.ticks for trial in summary.trials] == [2000, 2000]
    assert any(
        one.code is ProblemCode.MESSAGE_REFUSED and "ends after 1500 samples" in one.sentence
        for one in summary.problems
    )


def judging(node: Node) -> None:
    publisher = node.create_publisher(DiagnosticStatus, topics.STOPPING, qos.LATCHED)
    until_heard(publisher, 1)
    for trial in (1, 2):
        decision = StoppingDecision(trial=trial, samples=0, enough=True, due=None, bound=0.5)
        publisher.publish(status_message(decision))


def test_a_judgement_that_nobody_asked_for_ends_no_trial(tmp_path: Path) -> None:
    summary = disturbed(tmp_path / "out", judging)
    assert [trial.ticks for trial in summary.trials] == [2000, 2000]


def test_a_parameter_that_somebody_else_has_set_is_named_and_no_trial_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Disturbed(LifecycleManager):
        def configure(self, name: str) -> None:
            if name == topics.SIM_NODE:
                client = AsyncParameterClient(self._node, name)
                future = client.set_parameters([Parameter("sensors.torque.gain", value=[1.3, 1.3])])
                assert self._spin_until(future, PATIENCE)
            super().configure(name)

    monkeypatch.setattr(orchestrator, "LifecycleManager", Disturbed)
    out = tmp_path / "out"
    summary = run_experiment(ExperimentConfig.model_validate(SHORT), out)
    different = summary.problems[0]
    assert different.code is ProblemCode.PARAMETERS_DIFFER
    assert different.sentence.startswith("arm_sim: sensors.torque.gain is [1.3, 1.3], not ")
    assert not summary.trials
    active = yaml.safe_load((out / PARAMETERS_FILE).read_text(encoding="utf-8"))
    assert active["arm_sim"]["ros__parameters"]["sensors.torque.gain"] == [1.3, 1.3]
