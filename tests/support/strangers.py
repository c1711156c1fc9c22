"""Experiments that a stranger in the same domain disturbs: as if undisturbed, or refused."""

from __future__ import annotations

import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

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
from armimp_bringup.graph import DomainClaim
from armimp_bringup.orchestrator import run_experiment
from armimp_common import qos, topics
from armimp_common.cdr import CommandEncoder, command_number
from armimp_common.executor import Spinner
from armimp_common.lifecycle import LifecycleManager
from armimp_common.pubsub import JointStatePublisher, subscribe_raw
from armimp_common.status import (
    Level,
    Phase,
    StoppingDecision,
    TrialStatus,
    make_array,
    make_status,
    status_message,
)
from armimp_estimation.node import RESULT_NAME
from armimp_estimation.summary import Summary
from support.graph import joined

Rng = random.Random
PATIENCE = 20.0
BASE: dict[str, Any] = {"duration": 2.0}
JOINTS = ("shoulder", "elbow")
MOMENTS = ("before", "during", "random", "between", "after")
"""When: as the first trial begins to settle, is perturbed, at any time from there, and so on."""


class Stranger(Node):
    """Somebody in the domain of an experiment, who hears the commands."""

    def __init__(self, domain_id: int) -> None:
        super().__init__("stranger", context=joined(domain_id), use_global_arguments=False)
        self._last = 0
        subscribe_raw(self, topics.COMMANDS, Float64MultiArray, self._on_command)

    def _on_command(self, data: bytes) -> None:
        self._last = command_number(data)

    def last_number(self) -> int:
        """Listen for a moment; return the number of the newest command."""
        with Spinner([self], context=self.context) as spinner:
            spinner.spin_until(Future(), 0.1)
        return self._last


@dataclass(frozen=True)
class Case:
    """One disturbed run.

    Attributes
    ----------
    kind : name of the act
    moment : of `MOMENTS`, or a transition before which parameters are set
    seed : of what is random in it
    options : of the experiment, beside `BASE`
    """

    kind: str
    moment: str
    seed: int
    options: tuple[tuple[str, Any], ...] = ()


Act = Callable[[Stranger, Rng], object]


@dataclass(frozen=True)
class Outcome:
    """How a disturbed run ended.

    Attributes
    ----------
    verdict : same, refused, not delivered, or what must not be: wrong, silent
    seconds : wall time of the run
    problems : what the run says
    """

    case: Case
    verdict: str
    seconds: float
    problems: tuple[str, ...]


def heard(publisher: Any, listeners: int = 1) -> bool:
    """Wait until a publisher is matched; discovery needs nobody who spins."""
    end = time.monotonic() + PATIENCE
    while publisher.get_subscription_count() < listeners:
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


def command(torque: float, number: int, times: int = 1, *, leave: bool = False) -> Act:
    """Command torque on both joints; number −1 is that which comes next, as far as one can know."""

    def act(node: Stranger, rng: Rng) -> object:
        publisher = node.create_publisher(Float64MultiArray, topics.COMMANDS, qos.SAMPLE)
        assert heard(publisher, 3)
        encode = CommandEncoder(2).encode
        first = number if number >= 0 else node.last_number() + 1
        for one in range(times):
            publisher.publish(encode((torque, torque), first + one * (number < 0)))
        if leave:
            publisher.wait_for_all_acked(Duration(seconds=2))
            node.destroy_publisher(publisher)
            return None
        return publisher

    return act


def message(kind: type, topic: str, profile: Any, *contents: Callable[[Rng], Any]) -> Act:
    """Publish messages."""

    def act(node: Stranger, rng: Rng) -> object:
        publisher = node.create_publisher(kind, topic, profile)
        assert heard(publisher)
        for content in contents:
            publisher.publish(content(rng))
        return publisher

    return act


def status(**changes: Any) -> Callable[[Rng], DiagnosticStatus]:
    """Make a status of the first trial that is not the controller's."""
    values: dict[str, Any] = {
        "phase": Phase.PERTURB,
        "trial": 1,
        "trials": 2,
        "joint": 0,
        "joint_name": "shoulder",
        "tick": 500,
        "start_ns": 500_000_000,
        "ticks": 2000,
        "seed": 1,
        "valid": True,
        **changes,
    }
    return lambda _: status_message(TrialStatus(**values))


def decision(trial: int) -> Callable[[Rng], DiagnosticStatus]:
    """Make a decision that a trial may end."""
    made = StoppingDecision(trial=trial, samples=1000, enough=True, due=None, bound=0.5)
    return lambda _: status_message(made)


def received(count: int) -> Callable[[Rng], UInt64]:
    """Make a count of samples that the recorder did not send."""
    return lambda _: UInt64(data=count)


def sample(topic: str) -> Act:
    """Publish one sample that no rig measured, amid the others."""

    def act(node: Stranger, rng: Rng) -> object:
        field = topics.VALUE_FIELD[topic]
        channel = JointStatePublisher(node, topic, JOINTS, field)
        assert heard(channel.publisher)
        channel.publish(rng.choice((0, 700, 1500)) * topics.PERIOD_NS, (0.1, 0.1))
        return channel

    return act


TYPES = {
    one.__name__: one
    for one in (JointState, Float64MultiArray, DiagnosticStatus, DiagnosticArray, UInt64, Clock)
}


def garbage(topic: str, kind: type, profile: Any) -> Act:
    """Publish bytes that are no message of that type: none, a head alone, cut, absurd lengths."""

    def act(node: Stranger, rng: Rng) -> object:
        publisher = node.create_publisher(kind, topic, profile)
        assert heard(publisher)
        head = b"\0\1\0\0"
        good = bytes(serialize_message(kind()))
        for data in (
            head,
            head + b"\xff" * 60,
            good[: len(good) // 2 + 3],
            head + rng.randbytes(200),
            rng.randbytes(40),
            head + b"\0" * 12 + b"\xff\xff\xff\x7f" + b"\0" * 64,
        ):
            # The middleware refuses to send more than a message of fixed size takes.
            publisher.publish(data[: len(good)] if kind in (Clock, UInt64) else data)
        return publisher

    return act


ACTS: dict[str, Act] = {
    "zero command": command(0.0, 0),
    "zero command, leaves": command(0.0, 0, leave=True),
    "command": command(0.5, 0),
    "next number": command(0.0, -1, leave=True),
    "wrong numbers": command(0.3, 4_000_000_000, 20),
    "decision": message(DiagnosticStatus, topics.STOPPING, qos.LATCHED, decision(1), decision(2)),
    "shorter trial": message(DiagnosticStatus, topics.TRIAL, qos.LATCHED, status(ticks=1500)),
    "all is over": message(
        DiagnosticStatus, topics.TRIAL, qos.LATCHED, status(phase=Phase.DONE, trial=2)
    ),
    "result": message(
        DiagnosticStatus,
        topics.RESULT,
        qos.LATCHED,
        lambda _: make_status(RESULT_NAME, Level.OK, "valid", {"valid": "true"}),
    ),
    "error": message(
        DiagnosticArray,
        topics.DIAGNOSTICS,
        qos.DIAGNOSTICS,
        lambda _: make_array(0, [make_status("arm_sim: rig", Level.ERROR, "made up", {})]),
    ),
    **{
        f"received {count}": message(UInt64, topics.RECEIVED, qos.LATCHED, received(count))
        for count in (0, 10, 10**6, topics.RECORDER_GONE)
    },
    **{f"sample of {topic}": sample(topic) for topic in topics.VALUE_FIELD},
    **{
        f"bytes on {topic}": garbage(topic, TYPES[kind.rpartition("/")[2]], qos.PROFILES[topic])
        for topic, kind in topics.MESSAGE_TYPES.items()
    },
    **{
        f"bytes on {topic}": garbage(topic, String, qos.ALIVE)
        for topic in map(topics.alive, (topics.SIM_NODE, topics.CONTROLLER_NODE))
    },
}
PARAMETERS: dict[str, tuple[str, Parameter]] = {
    "torque gain": (topics.SIM_NODE, Parameter("sensors.torque.gain", value=[1.3, 1.3])),
}


def cases(seed: int, acts: dict[str, Act] | None = None) -> Iterator[Case]:
    """Every act at two moments of its own, and every parameter before both transitions."""
    rng = Rng(seed)
    for kind in acts or ACTS:
        for moment in rng.sample(MOMENTS, 2):
            yield Case(kind, moment, rng.randrange(2**31))
    for kind in PARAMETERS:
        for moment in ("configure", "activate"):
            yield Case(kind, moment, 0)


def judged(case: Case, reference: Summary, directory: Path) -> Outcome:
    """Run an experiment with its disturbance, and compare it with the one without."""
    begin = time.monotonic()
    try:
        summary, delivered = disturbed(case, directory)
    except Exception as error:  # noqa: BLE001 (of whatever kind: it is the finding)
        seconds = time.monotonic() - begin
        return Outcome(case, "traceback", seconds, (f"{type(error).__name__}: {error}",))
    seconds = time.monotonic() - begin
    if not summary.valid:
        verdict = "refused" if summary.faults else "silent"
    elif summary.estimators == reference.estimators:
        verdict = "same" if delivered else "not delivered"
    else:
        verdict = "wrong"
    return Outcome(case, verdict, seconds, tuple(map(str, summary.faults)))


def disturbed(case: Case, directory: Path) -> tuple[Summary, bool]:
    """Run an experiment with its disturbance; tell also whether that was delivered."""
    rng = Rng(case.seed)
    with DomainClaim() as claim:
        domain_id = claim.domain_id
    config = ExperimentConfig.model_validate({**BASE, **dict(case.options)})
    if case.kind in PARAMETERS:
        with _setting(case) as done:
            return run_experiment(config, directory, domain_id=domain_id).summary, bool(done)
    phases: Counter[Phase] = Counter()
    due = {
        "before": (Phase.SETTLE, 1),
        "during": (Phase.PERTURB, 1),
        "random": (Phase.SETTLE, 1),
        "between": (Phase.REST, 1),
        "after": (Phase.DONE, 1),
    }[case.moment]
    node = Stranger(domain_id)
    kept: list[object] = []
    threads: list[threading.Thread] = []

    def act() -> None:
        try:
            kept.append(ACTS[case.kind](node, rng))
        except AssertionError:
            return

    def later() -> None:
        time.sleep(rng.uniform(0.0, 0.6))
        act()

    def on_phase(phase: Phase) -> None:
        phases[phase] += 1
        if (phase, phases[phase]) != due or kept or threads:
            return
        # While this callback runs, a composed graph stands still.
        if case.moment == "random":
            threads.append(threading.Thread(target=later))
            threads[0].start()
        else:
            act()

    try:
        summary = run_experiment(config, directory, domain_id=domain_id, on_phase=on_phase).summary
    finally:
        for thread in threads:
            thread.join()
        node.context.try_shutdown()
    return summary, bool(kept)


@contextmanager
def _setting(case: Case) -> Iterator[list[bool]]:
    """Set a parameter just before the node makes a transition."""
    whose, parameter = PARAMETERS[case.kind]
    done: list[bool] = []

    class Disturbed(LifecycleManager):
        def change(self, name: str, transition: Any) -> None:
            if (name, transition) == (whose, case.moment):
                client = AsyncParameterClient(self._node, name)
                future = client.set_parameters([parameter])
                done.append(self._spin_until(future, PATIENCE))
            super().change(name, transition)

    with patch.object(orchestrator, "LifecycleManager", Disturbed):
        yield done
