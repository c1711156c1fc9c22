"""Runs an experiment: brings its nodes up, watches over them, and takes them down again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from armimp_bringup.compile_ahead import compile_ahead
from armimp_bringup.config import ExperimentConfig, prepare_directory, require_unused
from armimp_bringup.graph import GraphContext, external_domain
from armimp_bringup.nodes import (
    AskedParameters,
    ComposedNodes,
    ExternalNodes,
    NodeGroup,
    SeparateNodes,
)
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_common import topics
from armimp_common.errors import (
    ArmimpError,
    DataError,
    GraphError,
    InterruptionError,
    MalformedMessageError,
)
from armimp_common.executor import Spinner
from armimp_common.heartbeat import offer_heartbeat
from armimp_common.lifecycle import LifecycleManager
from armimp_common.pubsub import subscribe
from armimp_common.realtime import require_precedence, seldom_collecting
from armimp_common.schema import to_params_yaml
from armimp_common.status import (
    LIMITER_STATUS,
    Level,
    Phase,
    Progress,
    values_of,
)
from armimp_estimation.bags.writer import finish_bags, require_free_space
from armimp_estimation.metadata import Metadata
from armimp_estimation.node import RESULT_NAME
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.problems import Problem, ProblemCode, problem
from armimp_estimation.result import Result, conclude
from armimp_estimation.summary import SUMMARY_FILE, read_summary, write_summary

PARAMETERS_FILE = "parameters.yaml"
LOGS = "logs"
_STALL = 30.0  # s without news, after which an experiment has stalled
_PERIOD = 0.05  # s, between two checks of the state of an experiment
_LONG = 60.0  # s, longest wait for a lifecycle transition
_INTERRUPTED = problem(ProblemCode.INTERRUPTED)
_NICE = {False: 5, True: -10}
"""Niceness of the recorder in real time, by whether rig and controller have real-time priority.

Its computations between trials must not take the processor from them, but other programs should not
keep it from recording either.
"""


def run_experiment(
    config: ExperimentConfig,
    directory: Path,
    *,
    domain_id: int | None = None,
    on_progress: Callable[[Progress], None] = lambda _: None,
    on_phase: Callable[[Phase], None] = lambda _: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Result:
    """Run an experiment through the node graph.

    Parameters
    ----------
    config : ExperimentConfig
    directory : new directory for bags and results
    domain_id : ROS domain; by default a free one, or that of the environment if nodes are external
    on_progress : called a few times per second
    on_phase : called with each phase of each trial as it begins
    interrupted : called often; once it returns true, the experiment ends in good order, as invalid

    Returns
    -------
    Result
        Its summary is that of ``summary.json``. Curves and trials are there if the estimator was in
        this process; else `armimp_estimation.result.load_result` reads them.

    Raises
    ------
    ConfigurationError
        If the configuration is wrong.
    BagError
        If there is no space for the bags.
    GraphError
        If the graph could not be brought up.
    """
    directory = directory.absolute()
    parameters = node_parameters(config, directory)
    require_precedence(config.priority)
    require_unused(directory)
    external = config.processes == "external"
    if not external:
        compile_ahead(parameters)
    with GraphContext(external_domain(domain_id) if external else domain_id) as graph:
        # Made only once the domain is claimed, so that a failed claim leaves nothing behind.
        file = _prepare(directory, parameters)
        realtime = config.mode == "realtime"
        supervisor = Supervisor(graph, on_progress, on_phase=on_phase, realtime=realtime)
        with Spinner([supervisor]) as spinner:
            asked = AskedParameters(supervisor, spinner, parameters.by_node(), file)
            nodes: NodeGroup
            if external:
                nodes = ExternalNodes(supervisor, asked)
            elif config.processes == "composed":
                nodes = ComposedNodes(graph.context, spinner, file)
            else:
                nodes = SeparateNodes(file, directory / LOGS)
                if realtime:
                    nodes.renice(topics.ESTIMATOR_NODE, _NICE[config.priority > 0])
            course = Course(
                supervisor, spinner, nodes, interrupted=interrupted, confirm=asked.differences
            )
            problems, result = course.run()
    return settle(directory, parameters.estimator, result, [*problems, *supervisor.faults])


def _prepare(directory: Path, parameters: NodeParameters) -> Path:
    """Make the output directory and the file with the parameters in it."""
    prepare_directory(directory)
    ticks = round(parameters.controller.sequence.duration * topics.RATE)
    n = len(parameters.simulator.joints)
    require_free_space(directory, n * ticks, n)
    file = directory / PARAMETERS_FILE
    file.write_text(to_params_yaml(parameters.by_node()), encoding="utf-8")
    return file


class Supervisor(Node):
    """Listens to what the nodes report of the experiment.

    In real time a fault ends the experiment, and is ignored after the last trial.
    """

    def __init__(
        self,
        graph: GraphContext,
        on_progress: Callable[[Progress], None],
        *,
        on_phase: Callable[[Phase], None] = lambda _: None,
        realtime: bool = False,
    ) -> None:
        super().__init__(topics.SUPERVISOR_NODE, context=graph.context, use_global_arguments=False)
        self._on_progress, self._on_phase, self.realtime = on_progress, on_phase, realtime
        self.faults: list[Problem] = []
        """Faults that nodes reported on ``/diagnostics``."""
        self.concluded = self.finished = False
        """Whether there is a result, and whether all trials have ended, in good order or not."""
        self._done = False
        self._answered: str | None = None
        self.last_news = time.monotonic()
        offer_heartbeat(self, topics.SUPERVISOR_NODE)
        subscribe(self, topics.PROGRESS, self._on_progress_message)
        subscribe(self, topics.RESULT, self._on_result)
        subscribe(self, topics.TRIAL, self._on_trial)
        subscribe(self, topics.DIAGNOSTICS, self._on_diagnostics)

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
            if status.name == LIMITER_STATUS:
                # Answered samples are news, as phases without recording may be long.
                answered = values_of(status).get("tick")
                if answered != self._answered:
                    self._answered, self.last_news = answered, time.monotonic()
            if status.level == bytes([Level.ERROR]):
                self._note_fault(status.name, status.message)

    def _note_fault(self, source: str, reason: str) -> None:
        """Keep a new fault; one that continues a known fault replaces it."""
        new = problem(ProblemCode.NODE_FAULT, source=source, reason=reason)
        for index, known in enumerate(self.faults):
            if known.values["source"] == source:
                before = str(known.values["reason"])
                if reason.startswith(before):
                    self.faults[index] = new
                if reason.startswith(before) or before.startswith(reason):
                    return
        self.faults.append(new)


class Course:
    """The course of an experiment: nodes are brought up, watched over, and taken down again.

    Parameters
    ----------
    supervisor, spinner : the node that watches, and the executor of its callbacks
    nodes : the nodes
    interrupted : called often; once it returns true, the nodes are taken down
    confirm : returns a sentence for each parameter with another value than requested; called before
        the nodes are activated and after the last trial, while none has torque
    """

    def __init__(
        self,
        supervisor: Supervisor,
        spinner: Spinner,
        nodes: NodeGroup,
        *,
        interrupted: Callable[[], bool],
        confirm: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        self._supervisor, self._spinner, self._nodes = supervisor, spinner, nodes
        self._interrupted, self._confirm = interrupted, confirm
        self._manager = LifecycleManager(
            supervisor,
            nodes.names,
            spinner=spinner,
            timeout=_LONG,
            check=self._check,
        )
        self._configured: list[str] = []
        self._dead: set[str] = set()
        self._awaited: str | None = None  # during shutdown, the only node whose death matters
        self._problems: list[Problem] = []

    def run(self, drive: Callable[[], None] = lambda: None) -> tuple[list[Problem], Result | None]:
        """Run the experiment, calling ``drive`` once all nodes are active; then close the nodes.

        Return the problems, and the result of an estimator in this process.
        """
        try:
            try:
                if self.startup():
                    drive()
                    self.watch()
            except ArmimpError as error:
                # From the graph itself or, where nodes live in this process, from a callback.
                interrupted = isinstance(error, InterruptionError)
                failure = Problem.of(error, ProblemCode.NODE_FAILED)
                cause = _INTERRUPTED if interrupted else failure
                self._problems += self._deaths() or [cause]
            self.shutdown()
            result = self._nodes.result
        finally:
            crashed = self._nodes.close()
            self._spinner.remove_node(self._supervisor)
            self._supervisor.destroy_node()
        crashes = [problem(ProblemCode.NODE_FAILED, reason=how) for how in crashed]
        self._problems += [crash for crash in crashes if crash not in self._problems]
        return self._problems, result

    def startup(self) -> bool:
        """Configure and activate the nodes; return False if parameters are not as requested."""
        self._manager.wait_for_nodes()
        self._nodes.prepare(self._manager)
        for name in self._nodes.names:
            self._check()
            self._configured.append(name)
            self._manager.change(name, "configure")
        self._problems += self._differences()
        if self._problems:
            return False
        for name in self._nodes.names:
            self._check()
            self._manager.change(name, "activate")
        return True

    def watch(self) -> None:
        """Wait until all trials have ended and there is a result, or something goes wrong."""
        supervisor = self._supervisor
        supervisor.last_news = time.monotonic()

        def over() -> bool:
            if self._interrupted():
                self._problems.append(_INTERRUPTED)
            elif time.monotonic() - supervisor.last_news > _STALL:
                self._problems.append(problem(ProblemCode.STALLED, seconds=_STALL))
            self._problems.extend(self._deaths())
            if supervisor.finished:
                return bool(self._problems) or supervisor.concluded
            return bool(self._problems or (supervisor.realtime and supervisor.faults))

        with seldom_collecting():
            self._spinner.spin(over, period=_PERIOD)
        if not self._problems:
            self._problems += self._differences()

    def shutdown(self) -> None:
        """Retire all configured nodes that are alive, whatever has happened to the others."""
        for name in reversed(self._configured):
            self._problems += self._deaths()
            if name in self._dead:
                continue
            self._awaited = name
            try:
                self._nodes.retire(self._manager, name)
            except ArmimpError as error:
                failure = Problem.of(error, ProblemCode.NODE_FAILED)
                self._problems += self._deaths() or [failure]
        self._problems += self._deaths()

    def _deaths(self) -> list[Problem]:
        """Return problems about the nodes that died since the last call."""
        new = {name: how for name, how in self._nodes.dead().items() if name not in self._dead}
        self._dead |= set(new)
        return [problem(ProblemCode.NODE_FAILED, reason=how) for how in new.values()]

    def _differences(self) -> list[Problem]:
        return [problem(ProblemCode.PARAMETERS_DIFFER, reason=one) for one in self._confirm()]

    def _check(self) -> None:
        """Raise an error if a node that is waited for has died, or the user interrupts."""
        if self._awaited is None and self._interrupted():
            raise InterruptionError(_INTERRUPTED.sentence)
        dead = self._nodes.dead()
        if dead if self._awaited is None else self._awaited in dead:
            raise GraphError("a node died")


def settle(
    directory: Path,
    estimator: EstimatorParameters,
    found: Result | None,
    problems: Sequence[Problem],
) -> Result:
    """Merge the stored result of the estimator with what the orchestrator observed.

    Parameters
    ----------
    directory : where the estimator stores its summary
    estimator : parameters of the estimator, needed if it has stored no summary
    found : result of an estimator in this process
    problems : problems that the orchestrator observed
    """
    finish_bags(directory)  # a killed estimator could not
    path = directory / SUMMARY_FILE
    if not path.exists():
        result = conclude(
            [],
            known=Metadata.of(estimator.bag_metadata(), len(estimator.joints)),
            joint_names=estimator.joints,
            estimators=estimator.estimators,
            problems=problems,
        )
        try:
            write_summary(path, result.summary)
        except DataError as error:
            raise DataError("; ".join([*map(str, problems), str(error)])) from None
        return result
    result = Result(summary=read_summary(path)) if found is None else found
    summary = result.summary.with_problems(problems)
    if summary != result.summary:
        write_summary(path, summary, anew=True)
    return replace(result, summary=summary)
