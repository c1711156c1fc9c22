"""Runs an experiment: wires the graph, leads it through its life, and watches over it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.external import ExternalNodes, external_domain
from armimp_bringup.graph import ComposedNodes, GraphContext, NodeGroup, SeparateNodes
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_bringup.remote_parameters import Asked, RemoteParameters, read_back
from armimp_bringup.resources import prepare_directory, require_unused
from armimp_bringup.supervisor import Progress, Supervisor
from armimp_common import topics
from armimp_common.errors import (
    ArmimpError,
    DataError,
    GraphError,
)
from armimp_common.executor import Spinner
from armimp_common.lifecycle import LifecycleManager
from armimp_common.parameters import as_parameters
from armimp_common.realtime import require_precedence, seldom_collecting
from armimp_common.schema import to_params_yaml
from armimp_common.status import Phase
from armimp_estimation.bags import expected_bytes, require_free_space
from armimp_estimation.bags.finishing import finish_bags
from armimp_estimation.conclusion import SUMMARY_FILE, conclude
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.realtime_timing import RECORD_KEY, TimingRecord
from armimp_estimation.results import Summary, read_summary, write_summary

PARAMETERS_FILE = "parameters.yaml"
GRAPH_ORDER = (topics.ESTIMATOR_NODE, topics.CONTROLLER_NODE, topics.SIM_NODE)
"""Order of activation: whoever listens comes before whoever speaks."""
LOGS = "logs"
_STALL = 30.0
_PERIOD = 0.05
_INTERRUPTED = "interrupted by the user"
_NICE = {False: 5, True: -10}
"""Niceness of the recorder in real time, by whether the others have precedence over everything.

What it computes between trials must not take the processor from them; but other programs should not
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
) -> Summary:
    """Run an experiment through the node graph.

    Parameters
    ----------
    config : ExperimentConfig
    directory : Path
        New directory for bags and results.
    domain_id : int, optional
        ROS domain; by default a free one, or where nodes are external that of the environment.
    on_progress : callable
        Called a few times per second.
    on_phase : callable
        Called with each phase of each trial as it begins.
    interrupted : callable
        Asked often; once true, the experiment ends in good order, as invalid.

    Returns
    -------
    Summary
        As stored in ``summary.json``.

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
    problems: list[str] = []
    external = config.processes == "external"
    with GraphContext(external_domain(domain_id) if external else domain_id) as graph:
        # Not before the domain is ours, so that nothing is left behind where it is not.
        parameter_file = _prepare(directory, parameters)
        supervisor = Supervisor(graph, on_progress, on_phase=on_phase)
        with Spinner([supervisor], context=graph.context) as spinner:
            nodes: NodeGroup
            asked: Asked = {
                name: as_parameters(model) for name, model in parameters.by_node().items()
            }

            # Made early: where nodes are processes, discovery goes on while they start.
            remote = {name: RemoteParameters(supervisor, spinner, name) for name in asked}

            def confirm() -> list[str]:
                return read_back(remote, asked, parameter_file)

            care = Care(confirm=confirm)
            if external:
                nodes = guests = ExternalNodes(supervisor, GRAPH_ORDER)

                def prepare(manager: LifecycleManager) -> None:
                    nonlocal asked
                    asked = guests.prepare(manager, remote, parameters.by_node())

                care = Care(prepare=prepare, confirm=confirm, retire=guests.retire)
            elif config.processes == "composed":
                nodes = ComposedNodes(graph.context, spinner, parameter_file)
            else:
                nodes = SeparateNodes(parameter_file, directory / LOGS)
                if config.mode == "realtime":
                    nodes.renice(topics.ESTIMATOR_NODE, _NICE[config.priority > 0])
            try:
                supervisor.realtime = config.mode == "realtime"
                problems += lead(
                    supervisor, spinner, nodes, GRAPH_ORDER, interrupted=interrupted, care=care
                )
            finally:
                nodes.close()
                spinner.remove_node(supervisor)
                supervisor.destroy_node()
            if isinstance(nodes, SeparateNodes):
                problems += [crash for crash in nodes.crashed() if crash not in problems]
    problems += supervisor.problems
    timing = None
    if supervisor.timing is not None:
        limits = parameters.estimator.realtime.limits()
        timing = TimingRecord(figures=supervisor.timing, limits=limits)
    return settle(directory, parameters.estimator, problems, timing)


def _prepare(directory: Path, parameters: NodeParameters) -> Path:
    """Make the output directory and the file with the parameters in it."""
    prepare_directory(directory)
    ticks = round(parameters.controller.sequence.duration * topics.NS_PER_S / topics.PERIOD_NS)
    n = len(parameters.simulator.joints)
    require_free_space(directory, n * expected_bytes(ticks, n))
    parameter_file = directory / PARAMETERS_FILE
    parameter_file.write_text(to_params_yaml(parameters.by_node()), encoding="utf-8")
    return parameter_file


@dataclass(frozen=True, kw_only=True)
class Care:
    """What is done with nodes before they are configured, and when they are needed no more.

    Attributes
    ----------
    prepare : called once, when all nodes are there
    confirm : called before they are activated and when all is over, while none has torque and no
        time is lost by it; tells what is not as it was asked for
    retire : called for each node that was configured and lives, at the end
    """

    prepare: Callable[[LifecycleManager], None] = lambda _: None
    confirm: Callable[[], Sequence[str]] = tuple
    retire: Callable[[LifecycleManager, str], None] = LifecycleManager.shutdown


def lead(
    supervisor: Supervisor,
    spinner: Spinner,
    nodes: NodeGroup,
    names: Sequence[str],
    *,
    interrupted: Callable[[], bool],
    drive: Callable[[], None] = lambda: None,
    care: Care | None = None,
) -> list[str]:
    """Lead nodes through their life, by default from unconfigured to finalized.

    Parameters
    ----------
    supervisor, spinner : who watches, and what runs the callbacks
    nodes : the nodes
    names : their names, in the order of activation
    interrupted : asked often; once true, the nodes are taken down
    drive : called once all nodes are active
    care : what is done before and after

    Returns
    -------
    list of str
        What went wrong.
    """
    roll = _Roll(nodes, interrupted)
    care = care or Care()
    manager = LifecycleManager(
        supervisor, names, spin_until=spinner.spin_until, timeout=60.0, check=roll.check
    )
    problems: list[str] = []
    begun: list[str] = []
    try:
        manager.wait_for_nodes()
        care.prepare(manager)
        for name in names:
            roll.check()
            begun.append(name)
            manager.configure(name)
        problems += care.confirm()
        if not problems:
            for name in names:
                roll.check()
                manager.activate(name)
            supervisor.last_news = time.monotonic()
            drive()
            problems += _watch(supervisor, spinner, roll)
            problems += () if problems else care.confirm()
    except ArmimpError as error:
        # From the graph itself or, where nodes live in this process, from one of their callbacks.
        problems += roll.deaths() or [str(error)]
    # Those that were never asked for anything have nothing to close.
    return problems + _shut_down(manager, roll, begun, care)


class _Roll:
    """Which nodes are known to have died.

    Parameters
    ----------
    nodes : the nodes
    interrupted : as for :func:`lead`

    Attributes
    ----------
    awaited : the only node whose death matters to :meth:`check`, where the end can no longer be
        interrupted; None if each does
    told : sentences about those that died, by name
    """

    def __init__(self, nodes: NodeGroup, interrupted: Callable[[], bool]) -> None:
        self._nodes = nodes
        self.interrupted = interrupted
        self.awaited: str | None = None
        self.told: dict[str, str] = {}

    def deaths(self) -> list[str]:
        """Return sentences about those that died since the last call."""
        new = {name: how for name, how in self._nodes.dead().items() if name not in self.told}
        self.told.update(new)
        return list(new.values())

    def check(self) -> None:
        """Raise a GraphError if it is vain to wait any longer, or nobody wants to."""
        if self.awaited is None and self.interrupted():
            raise GraphError(_INTERRUPTED)
        dead = self._nodes.dead()
        if dead if self.awaited is None else self.awaited in dead:
            raise GraphError("a node died")


def _shut_down(
    manager: LifecycleManager, roll: _Roll, names: Sequence[str], care: Care
) -> list[str]:
    """Retire the nodes that live, whatever has happened to the others."""
    problems: list[str] = []
    for name in reversed(names):
        problems += roll.deaths()
        if name in roll.told:
            continue
        roll.awaited = name
        try:
            care.retire(manager, name)
        except ArmimpError as error:
            problems += roll.deaths() or [str(error)]
    return problems + roll.deaths()


def _watch(
    supervisor: Supervisor,
    spinner: Spinner,
    roll: _Roll,
) -> list[str]:
    problems: list[str] = []

    def over() -> bool:
        if roll.interrupted():
            problems.append(_INTERRUPTED)
        elif deaths := roll.deaths():
            problems.extend(deaths)
        elif time.monotonic() - supervisor.last_news > _STALL:
            problems.append(f"nothing happened for {_STALL:g} s")
        elif supervisor.realtime and supervisor.problems and not supervisor.finished:
            return True
        return bool(problems) or supervisor.over

    with seldom_collecting():
        spinner.spin(over, period=_PERIOD)
    return problems


def settle(
    directory: Path,
    estimator: EstimatorParameters,
    problems: Sequence[str],
    timing: TimingRecord | None = None,
) -> Summary:
    """Bring together what the estimator stored and what the orchestrator saw.

    Parameters
    ----------
    directory : Path
        Where the estimator stores its summary.
    estimator : EstimatorParameters
        Parameters of the estimator, for a run of which it left no summary.
    problems : sequence of str
        What the orchestrator saw go wrong.
    timing : TimingRecord, optional
        Timing up to the end of the experiment, of which the estimator did not see the last samples.
    """
    finish_bags(directory)  # An estimator that was killed could not.
    path = directory / SUMMARY_FILE
    if not path.exists():
        metadata = estimator.bag_metadata()
        conclusion = conclude(
            [],
            metadata=metadata if timing is None else {**metadata, RECORD_KEY: timing.to_json()},
            joint_names=estimator.joints,
            estimators=estimator.estimators,
            problems=problems,
        )
        try:
            write_summary(path, conclusion.summary)
        except DataError as error:
            raise DataError("; ".join([*problems, str(error)])) from None
        return conclusion.summary
    summary = read_summary(path)
    update: dict[str, Any] = {}
    known = summary.problems
    if timing is not None:
        before = [] if summary.timing is None else TimingRecord.of(summary.timing).problems
        known = [*timing.problems, *(problem for problem in known if problem not in before)]
        update["timing"] = timing.summary
    new = [problem for problem in problems if problem not in known]
    if update or new:
        known = [*new, *known]
        summary = summary.model_copy(update=update).judged(known)
        write_summary(path, summary, anew=True)
    return summary
