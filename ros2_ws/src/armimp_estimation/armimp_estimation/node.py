"""The estimator node: the ROS interface to recording, assembly and identification."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.serialization import deserialize_message

from armimp_common import topics
from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.cdr import encode_count
from armimp_common.errors import (
    ArmimpError,
    ConfigurationError,
    DataError,
    MalformedMessageError,
)
from armimp_common.executor import run_node, steady_timer
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.lifecycle import ManagedNode
from armimp_common.parameters import ParameterSet
from armimp_common.pubsub import (
    PollingNode,
    RawPublisher,
    create_publisher,
    subscribe,
    subscribe_raw,
    take_all,
    wait_for_partners,
)
from armimp_common.status import (
    Level,
    Phase,
    TimingFigures,
    TrialStatus,
    make_status,
    status_message,
    values_of,
)
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.alignment.synchronizer import TOGETHER, StreamSynchronizer
from armimp_estimation.alignment.trial_windows import fault_of
from armimp_estimation.frf import frf_matrix
from armimp_estimation.metadata import Timing
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.problems import Problem, ProblemCode, problem
from armimp_estimation.recorder import TrialRecorder
from armimp_estimation.result import Result, conclude
from armimp_estimation.trial import TrialData

_POLL_PERIOD = 0.001
"""Period at which messages are fetched (s); on a fast machine, that of 20 samples in lockstep."""
_PROGRESS_PERIOD = 0.2
"""Time between progress messages (s)."""
_STRAGGLERS = 5.0
"""Time after the end of the last trial in which its samples may still arrive (s)."""
_SHOWN = 16
"""Number of frequencies at which curves are published; files hold all."""
RESULT_NAME = f"{topics.ESTIMATOR_NODE}: impedance"


class ImpedanceEstimatorNode(PollingNode, ManagedNode):
    """Records all trials, estimates a column after each, and the whole matrix after the last."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(topics.ESTIMATOR_NODE, **kwargs)
        self.result: Result | None = None
        """Result of the trials since the last activation; None while more of them may come."""
        self._active = False
        self._rig = HeartbeatMonitor(self, topics.SIM_NODE, lambda _: None)
        self._controller = HeartbeatMonitor(self, topics.CONTROLLER_NODE, self._on_controller)
        # Created only once: a new subscription would get the last experiment's statuses again.
        self._trial = subscribe(self, topics.TRIAL, self._on_trial)
        self._declared = ParameterSet(
            self,
            EstimatorParameters,
            locked=lambda: "a trial is being recorded" if self._active else None,
        )

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the parameters and create publishers, subscriptions and timers."""
        self._settings = self._declared.load()
        # The stopping rule sees only recorded samples, so they are recorded in smaller groups.
        self._together = topics.RECEIVED_EVERY if self._settings.target_error else TOGETHER
        try:
            self._reset()
        except DataError as error:
            raise ConfigurationError(f"parameter 'metadata': {error}") from None
        self._progress = create_publisher(self, topics.PROGRESS)
        self._result = create_publisher(self, topics.RESULT)
        self._received = RawPublisher(self, topics.RECEIVED)
        self._stopping = create_publisher(self, topics.STOPPING)
        streams = {topic: self.subscribe_unattended(topic) for topic in topics.DATA_STREAMS}
        self._streams = list(streams.values())
        self._synchronizer = StreamSynchronizer(
            {topic: partial(take_all, stream) for topic, stream in streams.items()},
            self._on_samples,
        )
        self._synchronizer.close()
        self._poll = steady_timer(self, _POLL_PERIOD, self._synchronizer.poll, autostart=False)
        for topic in topics.RECORDED:
            if topic not in (*streams, topics.TRIAL):
                subscribe_raw(self, topic, partial(self._on_beside, topic))
        self._timer = steady_timer(self, _PROGRESS_PERIOD, self._on_timer, autostart=False)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the other nodes, then record."""
        self._declared.require_unchanged()
        wait_for_partners(
            self,
            subscriptions=[*self._streams, self._trial],
            monitors=[self._rig, self._controller],
        )
        self._active = True
        self.result = None
        self._synchronizer.open()  # messages that came before do not count
        self._recorded = 0
        self._received.send(encode_count(0))
        self._timer.reset()
        self._poll.reset()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the bag and conclude from the trials so far."""
        self._stop()
        self._reset()
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the bag and conclude from the trials so far."""
        if self._active:
            self._stop()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Close the bag and conclude, should the node end while it is active."""
        if self._active and self.context.ok():
            self._stop()
        super().destroy_node()

    def _reset(self) -> None:
        self._finished: list[Trial] = []
        self._problems: list[Problem] = []
        self._ended = 0
        self._done_at = math.inf
        self._recording = TrialRecorder(self._settings, self._on_finished, self._refuse)

    def _stop(self) -> None:
        self._end_recording()
        if self.result is None:
            # Noted first, as finishing the last trial computes the result.
            self._note(problem(ProblemCode.RECORDING_STOPPED))
        self._finish()

    def _end_recording(self) -> None:
        """Accept no more messages, and tell the nodes that wait for the recorder."""
        self._active = False
        self._synchronizer.close()
        self._received.send(encode_count(topics.RECORDER_GONE))
        self._timer.cancel()
        self._poll.cancel()

    def _finish(self) -> None:
        """Record all messages that have come, and conclude."""
        self._record(incomplete=True)
        with self._giving_up():
            self._recording.stop()
        self._conclude()

    def _on_samples(self, samples: int) -> None:
        """Record and acknowledge samples; `samples` counts them since the activation."""
        if samples - self._recorded >= self._together:
            self._recorded = samples
            self._record()
        if self._active:
            # Sent first, so that in lockstep the decision arrives before more samples are taken.
            if (decision := self._recording.decide()) is not None:
                self._stopping.publish(status_message(decision))
            self._received.send(encode_count(samples))

    @contextmanager
    def _giving_up(self) -> Iterator[None]:
        """If recording fails in this context, note the problem, close the bag and conclude."""
        try:
            yield
        except ArmimpError as error:
            self._note(Problem.of(error, ProblemCode.RECORDING_FAILED))
            self._end_recording()
            with suppress(ArmimpError):
                # Closing the bag writes these messages, if that is still possible.
                self._recording.add(self._synchronizer.take())
            try:
                self._recording.close()
            except ArmimpError as again:
                self._note(Problem.of(again, ProblemCode.RECORDING_FAILED))
            self._conclude()

    def _record(self, *, incomplete: bool = False) -> None:
        """Record the messages that are waiting."""
        with self._giving_up():
            self._recording.add(self._synchronizer.take(incomplete=incomplete))

    def _on_beside(self, topic: str, message: bytes) -> None:
        if not self._active:
            return
        if topic == topics.DIAGNOSTICS:
            self._note_timing(message)
        self._record()  # so that the message gets the time of the latest sample
        with self._giving_up():
            self._recording.add_beside(topic, message)

    def _note_timing(self, message: bytes) -> None:
        """Keep the latest timing that the rig reports in real time."""
        if TimingFigures.STATUS_NAME.encode() not in message:
            return
        try:
            for status in deserialize_message(message, DiagnosticArray).status:
                if status.name == TimingFigures.STATUS_NAME:
                    figures = TimingFigures.from_values(values_of(status))
                    timing = Timing(**dict(figures), **dict(self._settings.realtime))
                    known = self._recording.known.model_copy(update={"timing": timing})
                    self._recording.known = known
        except (MalformedMessageError, RuntimeError, ValueError) as error:
            self._refuse(topics.DIAGNOSTICS, error)

    def _on_trial(self, message: DiagnosticStatus) -> None:
        if not self._active:
            return
        try:
            status = TrialStatus.from_values(values_of(message))
        except MalformedMessageError as error:
            self._refuse(topics.TRIAL, error)
            return
        if reason := self._recording.contradiction(status):
            self._refuse(topics.TRIAL, reason)
            return
        fault = fault_of(status)
        if fault is not None and fault.code is not ProblemCode.SAMPLES_LOST:
            self._note(fault)
        self._record(incomplete=status.phase is Phase.ABORTED)
        if self._active:
            with self._giving_up():
                self._recording.add_status(status)
        if not self._active:
            return
        if status.phase is Phase.ABORTED:
            self._finish()
        elif status.phase is Phase.DONE:
            # Samples of the last trial may be under way, as topics do not wait for one another.
            self._done_at = time.monotonic()
            if self._recording.status is None:
                self._conclude()

    def _on_controller(self, controller: HeartbeatMonitor) -> None:
        """Finish when the controller is lost, as nobody else would announce the end."""
        if controller.presence.lost and self._active and self.result is None:
            if self._done_at == math.inf:
                self._note(problem(ProblemCode.NODE_FAILED, reason=controller.sentence))
            self._finish()

    def _on_finished(self, trial: Trial | Problem) -> None:
        self._ended += 1
        if isinstance(trial, Problem):
            self._note(trial)
        else:
            self._finished.append(trial)
            self._result.publish(column_message(trial))
        if self._ended == len(self._settings.joints):
            self._conclude()

    def _conclude(self) -> None:
        """Compute, store and publish the result, once."""
        if self.result is not None:
            return
        self.result = result = conclude(
            self._finished,
            known=self._recording.known,
            joint_names=self._settings.joints,
            estimators=self._settings.estimators,
            problems=self._problems,
        )
        if self._settings.directory:
            directory = Path(self._settings.directory)
            try:
                directory.mkdir(parents=True, exist_ok=True)
                result.write(directory)
            except (ArmimpError, OSError) as error:
                self.get_logger().error(f"result not stored: {error}")
        self._result.publish(result_message(result))

    def _note(self, new: Problem) -> None:
        if new not in self._problems:
            self._problems.append(new)
            self.get_logger().error(new.sentence)

    def _refuse(self, topic: str, reason: object) -> None:
        self._note(problem(ProblemCode.MESSAGE_REFUSED, stream=topic, reason=str(reason)))

    def _on_timer(self) -> None:
        if self._active:
            # While samples are incomplete, nothing else records the messages that come.
            self._record()
        if not self._active or self._recording.status is None:
            return
        if time.monotonic() - self._done_at > _STRAGGLERS:
            self._finish()
            return
        if (progress := self._recording.progress()) is not None:
            self._progress.publish(status_message(progress))


def column_message(trial: Trial) -> DiagnosticStatus:
    """Make the status with column k of T, R and ``Z = T/R_kk``, or the reason why there is none."""
    k = trial.joint + 1
    name = f"{topics.ESTIMATOR_NODE}: column {k}"
    values = {"trial": trial.trial, "joint": k, "lost": trial.statistics.lost}
    try:
        parts = trial.intact()
        frf = frf_matrix([TrialData.of(*parts)])
    except DataError as error:
        return make_status(name, Level.ERROR, str(error), values)
    R, T = frf.R[:, 0], frf.T[:, 0]
    curves = {
        f"{letter}_{i + 1}{k}": row
        for letter, curve in (("R", R), ("T", T), ("Z", T / R[trial.joint]))
        for i, row in enumerate(curve)
    }
    text = f"trial {trial.trial}: column {k} of the impedance"
    return make_status(name, Level.OK, text, {**values, **_selected(frf.f, curves)})


def result_message(result: Result) -> DiagnosticStatus:
    """Make the status with M, B, K, their standard errors, scores, and Z at some frequencies."""
    summary = result.summary
    codes = dict.fromkeys(one.code.value for one in summary.faults)
    values: dict[str, str | bool | list[float]] = {
        "valid": summary.valid,
        "problems": " ".join(codes),
    }
    for name, found in summary.estimators.items():
        for key in ("M", "B", "K", "M_se", "B_se", "K_se", "vaf", "r2", "coherence_derived"):
            matrix = getattr(found, key)
            if matrix is not None:
                values[f"{name}.{key}"] = [value for row in matrix for value in row]
    for name, curve in result.curves.items():
        elements = {
            f"Z_{i + 1}{k + 1}": element
            for i, row in enumerate(curve.Z)
            for k, element in enumerate(row)
        }
        chosen = _selected(curve.f, elements)
        values |= {f"{name}.{key}": numbers for key, numbers in chosen.items()}
    return make_status(
        RESULT_NAME,
        Level.OK if summary.valid else Level.ERROR,
        "valid" if summary.valid else f"not valid: {summary.faults[0]}",
        values,
    )


def _selected(f: FloatArray, curves: Mapping[str, ComplexArray]) -> dict[str, list[float]]:
    """Real and imaginary parts at up to 16 frequencies, evenly spread over their logarithm."""
    places = list(range(f.size))
    if f.size > _SHOWN:
        ratio = (f.size - 1) ** (1.0 / (_SHOWN - 1))
        places = sorted({0} | {round(ratio**power) for power in range(_SHOWN)})
    parts = {
        f"{name}.{part}": values[places].tolist()
        for name, curve in curves.items()
        for part, values in (("re", curve.real), ("im", curve.imag))
    }
    return {"f": f[places].tolist(), **parts}


def main() -> int:
    """Run the estimator node as a process."""
    return run_node(ImpedanceEstimatorNode)


if __name__ == "__main__":
    sys.exit(main())
