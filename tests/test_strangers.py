"""What a stranger in the same domain can do to an experiment: end it, never falsify its result."""

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.serialization import serialize_message
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String, UInt64

from armimp_bringup import orchestrator
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import PARAMETERS_FILE, run_experiment
from armimp_common import qos, topics
from armimp_common.cdr import CommandEncoder, JointStateEncoder, command_number
from armimp_common.executor import Spinner
from armimp_common.lifecycle import LifecycleManager
from armimp_common.pubsub import subscribe_raw
from armimp_common.status import (
    Level,
    Phase,
    StoppingDecision,
    make_array,
    make_status,
    status_message,
)
from armimp_estimation.node import RESULT_NAME
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import Summary
from support.graph import PATIENCE, free_domain, joined
from support.processes import wait_until
from support.runs import FinishedRun
from support.streams import trial_status

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("environment")]

BASE: dict[str, Any] = {"duration": 2.0}
MOMENTS = {
    "before": Phase.SETTLE,
    "during": Phase.PERTURB,
    "between": Phase.REST,
    "after": Phase.DONE,
}
"""When: as the controller first announces a phase."""


class Stranger(Node):
    """A node in the domain of an experiment that is no part of it, and hears the commands."""

    def __init__(self, domain_id: int) -> None:
        super().__init__("stranger", context=joined(domain_id), use_global_arguments=False)
        self._last = 0
        subscribe_raw(self, topics.COMMANDS, self._on_command)

    def _on_command(self, data: bytes) -> None:
        self._last = command_number(data)

    def last_number(self) -> int:
        """Listen for a moment; return the number of the newest command."""
        with Spinner([self]) as spinner:
            spinner.spin_until(Future(), 0.1)
        return self._last


@dataclass(frozen=True, kw_only=True)
class Act:
    """Messages, or malformed bytes, which a stranger publishes."""

    topic: str
    kind: Any
    contents: Sequence[Any] = ()
    profile: Any = None
    listeners: int = 1
    """Number of subscribers to wait for; discovery works without spinning."""
    leave: bool = False

    def __call__(self, node: Stranger) -> object:
        """Publish them; return what must be kept alive for as long as the stranger is to stay."""
        profile = self.profile or qos.PROFILES[self.topic]
        publisher = node.create_publisher(self.kind, self.topic, profile)
        wait_until(
            lambda: bool(publisher.get_subscription_count() >= self.listeners),
            f"somebody hears {self.topic}",
        )
        for content in self.contents:
            publisher.publish(content(node) if callable(content) else content)
        if self.leave:
            publisher.wait_for_all_acked(Duration(seconds=2))
            node.destroy_publisher(publisher)
        return publisher


def command(torque: float, number: int | None, times: int = 1, *, leave: bool = False) -> Act:
    """Command torque on both joints with a number, or with that which comes next."""

    def encoded(node: Stranger) -> bytes:
        return encode((torque, torque), node.last_number() + 1 if number is None else number)

    encode = CommandEncoder(2).encode
    contents = [encoded] * times
    kind, topic = Float64MultiArray, topics.COMMANDS
    return Act(topic=topic, kind=kind, contents=contents, listeners=3, leave=leave)


def messages(topic: str, *contents: Any) -> Act:
    """Messages of one type."""
    return Act(topic=topic, kind=type(contents[0]), contents=contents)


def sample(topic: str) -> Act:
    """One sample that no rig measured, amid the others."""
    encoder = JointStateEncoder(("shoulder", "elbow"), topics.VALUE_FIELD[topic])
    raw = encoder.encode(700 * topics.PERIOD_NS, (0.1, 0.1))
    return Act(topic=topic, kind=JointState, contents=[raw])


def garbage(topic: str, kind: type, profile: Any = None) -> Act:
    """Bytes that are no message of that type: a head alone, noise, cut, absurd lengths."""
    head, good = b"\0\1\0\0", bytes(serialize_message(kind()))
    contents = [
        head,
        head + b"\xff" * 60,
        good[: len(good) // 2 + 3],
        random.Random(1).randbytes(200),
        head + b"\0" * 12 + b"\xff\xff\xff\x7f" + b"\0" * 64,
    ]
    if kind in (Clock, UInt64):  # of fixed size: the middleware refuses to send more
        contents = [one[: len(good)] for one in contents]
    return Act(topic=topic, kind=kind, contents=contents, profile=profile)


_TYPES = {
    one.__name__: one
    for one in (JointState, Float64MultiArray, DiagnosticStatus, DiagnosticArray, UInt64, Clock)
}
_DECISIONS = [
    status_message(StoppingDecision(trial=trial, samples=1000, enough=True, due=None, bound=0.5))
    for trial in (1, 2)
]
ACTS: dict[str, Act] = {
    "zero command": command(0.0, 0),
    "zero command, leaves": command(0.0, 0, leave=True),
    "next number": command(0.0, None, leave=True),
    "wrong numbers": command(0.3, 4_000_000_000, 20),
    "decision": messages(topics.STOPPING, *_DECISIONS),
    "shorter trial": messages(topics.TRIAL, status_message(trial_status(ticks=1500))),
    "all is over": messages(topics.TRIAL, status_message(trial_status(phase=Phase.DONE, trial=2))),
    "result": messages(
        topics.RESULT, make_status(RESULT_NAME, Level.OK, "valid", {"valid": "true"})
    ),
    "error": messages(
        topics.DIAGNOSTICS, make_array(0, [make_status("arm_sim: rig", Level.ERROR, "made up", {})])
    ),
    **{
        f"received {count}": messages(topics.RECEIVED, UInt64(data=count))
        for count in (0, 10**6, topics.RECORDER_GONE)
    },
    **{f"sample of {topic}": sample(topic) for topic in topics.VALUE_FIELD},
    **{
        f"bytes on {topic}": garbage(topic, _TYPES[kind.rpartition("/")[2]])
        for topic, (kind, *_) in topics.TOPICS.items()
    },
    **{
        f"bytes on {topic}": garbage(topic, String, qos.ALIVE)
        for topic in map(topics.alive, (topics.SIM_NODE, topics.CONTROLLER_NODE))
    },
}
HARMLESS = {
    *("decision", "result", "received 0", "received 1000000", f"received {topics.RECORDER_GONE}"),
    *(f"bytes on {topic}" for topic in (topics.JOINT_STATES, topics.CLOCK, topics.DIAGNOSTICS)),
    *(f"bytes on {topic}" for topic in (topics.TRIAL, topics.RESULT, topics.STOPPING)),
    *(f"bytes on {one}" for one in ("impedance_estimator/progress", "arm_sim/alive")),
    "bytes on imbic_controller/alive",
}
"""What must leave the result valid, at the moment at which the last test here does it."""


def disturbed(kind: str, directory: Path, moment: str = "during", **options: Any) -> Summary:
    """Run an experiment in which a stranger does this; a composed graph stands still meanwhile."""
    domain_id = free_domain()
    node, phases, kept = Stranger(domain_id), Counter[Phase](), list[object]()

    def on_phase(phase: Phase) -> None:
        phases[phase] += 1
        if phase is MOMENTS[moment] and phases[phase] == 1:
            kept.append(ACTS[kind](node))

    config = ExperimentConfig.model_validate({**BASE, **options})
    try:
        summary = run_experiment(config, directory, domain_id=domain_id, on_phase=on_phase).summary
    finally:
        node.context.try_shutdown()
    assert kept
    return summary


@pytest.mark.parametrize(
    ("kind", "processes", "who"),
    [
        ("zero command", "composed", "/stranger"),
        ("zero command, leaves", "composed", "/imbic_controller"),
        ("wrong numbers", "separate", "/stranger"),
    ],
)
def test_one_command_of_somebody_else_is_a_fault_with_who_and_when(
    tmp_path: Path, kind: str, processes: str, who: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if who == "/stranger":
        # On a busy machine the name of its node may arrive late.
        monkeypatch.setattr("armimp_common.driver_base._NAMES_PATIENCE", PATIENCE)
    summary = disturbed(kind, tmp_path / "out", processes=processes)
    assert not summary.valid
    faults = [one.values for one in summary.problems if one.code is ProblemCode.NODE_FAULT]
    (fault,) = [str(one["reason"]) for one in faults if one["source"] == "arm_sim: rig"]
    assert topics.COMMANDS in fault
    when, _, publishers = fault.partition("; published by ")
    assert when.endswith(" s")
    assert who in publishers.split(", ")


def test_a_status_that_ends_a_trial_early_is_refused_and_spoils_the_result(tmp_path: Path) -> None:
    summary = disturbed("shorter trial", tmp_path / "out")
    assert not summary.valid
    assert [trial.ticks for trial in summary.trials] == [2000, 2000]
    assert any(
        one.code is ProblemCode.MESSAGE_REFUSED and "ends after 1500 samples" in one.sentence
        for one in summary.problems
    )


def test_a_judgement_that_nobody_asked_for_ends_no_trial(tmp_path: Path) -> None:
    summary = disturbed("decision", tmp_path / "out")
    assert [trial.ticks for trial in summary.trials] == [2000, 2000]


def test_a_parameter_that_somebody_else_has_set_is_named_and_no_trial_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gain = Parameter("sensors.torque.gain", value=[1.3, 1.3])

    class Disturbed(LifecycleManager):
        def change(self, name: str, transition: Any) -> None:
            if (name, transition) == (topics.SIM_NODE, "configure"):
                client = AsyncParameterClient(self._node, name)
                assert self._spin_until(client.set_parameters([gain]), PATIENCE)
            super().change(name, transition)

    monkeypatch.setattr(orchestrator, "LifecycleManager", Disturbed)
    config, out = ExperimentConfig.model_validate(BASE), tmp_path / "out"
    summary = run_experiment(config, out).summary
    different = summary.problems[0]
    assert different.code is ProblemCode.PARAMETERS_DIFFER
    assert different.sentence.startswith("arm_sim: sensors.torque.gain is [1.3, 1.3], not ")
    assert not summary.trials
    active = yaml.safe_load((out / PARAMETERS_FILE).read_text(encoding="utf-8"))
    assert active["arm_sim"]["ros__parameters"]["sensors.torque.gain"] == [1.3, 1.3]


@pytest.mark.timeout(1800)
def test_whatever_a_stranger_does_a_valid_result_is_that_of_the_undisturbed_run(
    tmp_path: Path, composed: FinishedRun
) -> None:
    assert composed.summary.valid
    valid = 0
    for kind, moment in zip(ACTS, cycle(MOMENTS), strict=False):
        summary = disturbed(kind, tmp_path / kind.replace("/", " "), moment)
        valid += summary.valid
        assert summary.valid or kind not in HARMLESS, (kind, summary.problems)
        assert not summary.valid or summary.estimators == composed.summary.estimators, kind
    assert ACTS.keys() >= HARMLESS
    assert valid < len(ACTS)
