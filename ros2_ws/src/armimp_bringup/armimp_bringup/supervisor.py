"""What the orchestrator hears of an experiment while it runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from armimp_bringup.graph import GraphContext
from armimp_common import qos, topics
from armimp_common.errors import MalformedMessageError
from armimp_common.heartbeat import Heartbeat
from armimp_common.status import (
    LIMITER_STATUS,
    Level,
    Phase,
    Progress,
    TimingFigures,
    values_of,
)
from armimp_estimation.messages import RESULT_NAME
from armimp_estimation.problems import Problem, ProblemCode, problem


class Supervisor(Node):
    """Listens to everything that tells how the experiment goes."""

    def __init__(
        self,
        graph: GraphContext,
        on_progress: Callable[[Progress], None],
        *,
        on_phase: Callable[[Phase], None] = lambda _: None,
    ) -> None:
        super().__init__(topics.SUPERVISOR_NODE, context=graph.context, use_global_arguments=False)
        self._on_progress = on_progress
        self._on_phase = on_phase
        self.faults: list[Problem] = []
        """What nodes told of on ``/diagnostics``."""
        self.concluded = self.finished = False
        self.realtime = False
        """Whether a fault ends the experiment at once, and does not matter after its last trial."""
        self.timing: TimingFigures | None = None
        """Last figures of a rig in real time."""
        self._done = False
        self._answered: str | None = None
        self.last_news = time.monotonic()
        self._sign = Heartbeat(self, topics.SUPERVISOR_NODE)
        self.create_subscription(
            DiagnosticStatus, topics.PROGRESS, self._on_progress_message, qos.PROGRESS
        )
        self.create_subscription(DiagnosticStatus, topics.RESULT, self._on_result, qos.LATCHED)
        self.create_subscription(DiagnosticStatus, topics.TRIAL, self._on_trial, qos.LATCHED)
        self.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.DIAGNOSTICS
        )

    @property
    def over(self) -> bool:
        """Whether all trials have ended, in good order or not, and there is a result."""
        return self.concluded and self.finished

    def _on_progress_message(self, message: DiagnosticStatus) -> None:
        try:
            progress = Progress.from_values(values_of(message))
        except MalformedMessageError as error:
            self.get_logger().warning(f"{topics.PROGRESS}: refused: {error}", once=True)
            return
        if progress.samples:
            self.last_news = time.monotonic()
        self._on_progress(progress)

    def _on_result(self, message: DiagnosticStatus) -> None:
        self.last_news = time.monotonic()
        if message.name == RESULT_NAME:
            self.concluded = True

    def _on_trial(self, message: DiagnosticStatus) -> None:
        try:
            phase = Phase(values_of(message).get("phase"))
        except ValueError:  # the estimator complains
            return
        self._done = self._done or phase is Phase.DONE
        self.finished = self.finished or phase in (Phase.DONE, Phase.ABORTED)
        self._on_phase(phase)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if self.realtime and self._done:
            return
        for status in message.status:
            self._note_answers(status)
            # Up to an abort, but what comes after it is better than nothing.
            if status.name == TimingFigures.STATUS_NAME and not (
                self.finished and self.timing is not None
            ):
                with suppress(MalformedMessageError):  # the estimator complains
                    self.timing = TimingFigures.from_values(values_of(status))
            if status.level == bytes([Level.ERROR]):
                self._note_fault(status.name, status.message)

    def _note_fault(self, source: str, reason: str) -> None:
        """Keep a fault that is new; one that goes on takes the place of its beginning."""
        new = problem(ProblemCode.NODE_FAULT, source=source, reason=reason)
        for index, known in enumerate(self.faults):
            if known.values["source"] == source:
                before = str(known.values["reason"])
                if reason.startswith(before):
                    self.faults[index] = new
                if reason.startswith(before) or before.startswith(reason):
                    return
        self.faults.append(new)

    def _note_answers(self, status: DiagnosticStatus) -> None:
        """Samples that are answered are news, also where a phase without recording is long."""
        if status.name == LIMITER_STATUS:
            answered = values_of(status).get("tick")
            if answered != self._answered:
                self._answered = answered
                self.last_news = time.monotonic()
