"""The estimator and the controller: it concludes when that is lost, and forgets what is over."""

import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.context import Context
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from armimp_common import qos, topics
from armimp_common.executor import Spinner
from armimp_common.pubsub import wait_until_matched
from armimp_common.status import Phase, TrialStatus, status_message
from armimp_estimation.messages import RESULT_NAME
from armimp_estimation.node import ImpedanceEstimatorNode
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.summary import read_summary
from support.graph import PATIENCE, a_moment, eventually, overrides

SUCCESS = TransitionCallbackReturn.SUCCESS


class Surroundings:
    """Stands for simulator, controller and people."""

    def __init__(self, context: Context, node: Node, spinner: Spinner, out: Path | None) -> None:
        self.node, self.spinner, self.out = node, spinner, out
        self.conclusions = 0
        self.streams = [
            node.create_publisher(
                Float64MultiArray if topic == topics.COMMANDS else JointState, topic, qos.SAMPLE
            )
            for topic in topics.DATA_STREAMS
        ]
        self.trial = node.create_publisher(DiagnosticStatus, topics.TRIAL, qos.LATCHED)
        self.results = node.create_subscription(
            DiagnosticStatus, topics.RESULT, self.on_result, qos.LATCHED
        )
        settings = EstimatorParameters(directory=str(out or ""))
        self.estimator = ImpedanceEstimatorNode(
            context=context, parameter_overrides=overrides(settings)
        )
        spinner.add_node(self.estimator)

    def on_result(self, message: DiagnosticStatus) -> None:
        self.conclusions += message.name == RESULT_NAME

    def bring_up(self) -> None:
        estimator = self.estimator
        assert estimator.trigger_configure() is SUCCESS, estimator.transition_error
        assert estimator.trigger_activate() is SUCCESS, estimator.transition_error
        assert not wait_until_matched(
            self.node,
            publishers=[*self.streams, self.trial],
            subscriptions=[self.results],
            timeout_s=PATIENCE,
        )

    @property
    def problems(self) -> list[str]:
        assert self.out is not None
        return list(map(str, read_summary(self.out / "summary.json").problems))

    def announce(self, phase: Phase) -> None:
        status = TrialStatus(
            phase=phase,
            trial=1,
            trials=2,
            joint=0,
            joint_name="shoulder",
            tick=0,
            start_ns=0,
            ticks=100,
            seed=1,
            valid=True,
        )
        self.trial.publish(status_message(status))

    def heard(self, *, alive: int, silent: int) -> None:
        self.estimator._controller._on_event(
            SimpleNamespace(alive_count=alive, not_alive_count=silent)
        )


@pytest.fixture
def out(tmp_path: Path) -> Path | None:
    return tmp_path / "out"


@pytest.fixture
def around(context: Context, node: Node, out: Path | None) -> Iterator[Surroundings]:
    with Spinner([node]) as spinner:
        surroundings = Surroundings(context, node, spinner, out)
        yield surroundings
        spinner.remove_node(surroundings.estimator)
        surroundings.estimator.destroy_node()


def test_when_the_controller_is_lost_expect_a_conclusion_with_the_reason(
    around: Surroundings,
) -> None:
    around.bring_up()
    around.announce(Phase.PERTURB)
    eventually(around.spinner, lambda: around.estimator._recording.status is not None, "the trial")
    around.heard(alive=1, silent=0)
    a_moment(around.spinner)
    assert around.conclusions == 0

    around.heard(alive=0, silent=1)

    eventually(around.spinner, lambda: around.conclusions == 1, "the conclusion")
    assert around.problems[0].startswith("imbic_controller gave no sign of life for")


def test_when_the_controller_leaves_after_the_end_expect_no_complaint(
    around: Surroundings,
) -> None:
    around.bring_up()
    around.announce(Phase.PERTURB)
    around.announce(Phase.DONE)
    eventually(around.spinner, lambda: around.estimator._done_at < math.inf, "the end")
    around.heard(alive=1, silent=0)

    around.heard(alive=0, silent=0)

    eventually(around.spinner, lambda: around.conclusions == 1, "the conclusion")
    assert not any("imbic_controller" in problem for problem in around.problems)


@pytest.mark.parametrize("out", [None])
def test_statuses_of_the_last_experiment_count_no_more_after_a_new_configuration(
    around: Surroundings,
) -> None:
    around.bring_up()
    around.announce(Phase.PERTURB)
    around.announce(Phase.DONE)
    eventually(around.spinner, lambda: around.estimator._done_at < math.inf, "the end")
    for transition in ("deactivate", "cleanup"):
        assert getattr(around.estimator, f"trigger_{transition}")() is SUCCESS
    eventually(around.spinner, lambda: around.conclusions == 1, "the conclusion")

    around.bring_up()
    a_moment(around.spinner, 0.5)

    assert around.estimator._done_at == math.inf
    assert around.estimator._recording.status is None
    around.announce(Phase.SETTLE)
    eventually(
        around.spinner, lambda: around.estimator._recording.status is not None, "the new trial"
    )
