"""The nodes of an experiment, wherever they run, and their parameters."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from armimp_common.errors import GraphError
from armimp_common.executor import NO_LOG_FILES, Spinner
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.lifecycle import LifecycleManager, ServiceClients
from armimp_common.parameters import as_parameters
from armimp_common.process import ParentWatchdog
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE
from armimp_estimation.metadata import CALIBRATION_KEYS
from armimp_estimation.result import Result

NODES = (ESTIMATOR_NODE, CONTROLLER_NODE, SIM_NODE)
"""In the order of activation: listeners first and the rig last, so that no sample is missed."""
MODULES: Mapping[str, Sequence[str]] = {
    SIM_NODE: ("armimp_sim.node",),
    CONTROLLER_NODE: ("armimp_control.node",),
    ESTIMATOR_NODE: ("armimp_estimation.node",),
}
"""Module of each node, with the first arguments of its process."""
_SERVICES: Mapping[str, Any] = {
    "list_parameters": ListParameters,
    "get_parameters": GetParameters,
    "set_parameters_atomically": SetParametersAtomically,
}
_TO_END = 5.0  # s, for processes to end after a signal
_TO_ANSWER = 10.0  # s, for a node to answer a service call


class AskedParameters(ServiceClients):
    """The parameters requested of nodes: sets them, and compares them with the active ones.

    Parameters
    ----------
    node, spinner : the node that asks, and what spins it
    models : parameters by the name of the node
    record : file for all active parameters of each node; written if some are not as requested

    Raises
    ------
    GraphError
        From every method, if a node does not answer.
    """

    def __init__(
        self, node: Node, spinner: Spinner, models: Mapping[str, BaseModel], record: Path
    ) -> None:
        # Made early, so that discovery goes on while processes of nodes start. Parameter clients of
        # rclpy would block for a quarter of a second wherever discovery takes a moment.
        super().__init__(node, models, _SERVICES, spinner=spinner, timeout=_TO_ANSWER)
        self.asked = {name: as_parameters(model) for name, model in models.items()}
        self._record = record

    def names(self, name: str) -> set[str]:
        """Return the names of the parameters that a node has."""
        request = ListParameters.Request()
        return set(self._ask(name, "list_parameters", request, "name its parameters").result.names)

    def give(self, name: str) -> None:
        """Set all parameters of a node, or none.

        Raises
        ------
        GraphError
            If the node refuses them.
        """
        messages = [parameter.to_parameter_msg() for parameter in self.asked[name]]
        request = SetParametersAtomically.Request(parameters=messages)
        result = self._ask(name, "set_parameters_atomically", request, "take parameters").result
        if not result.successful:
            raise GraphError(f"node {name} refused its parameters: {result.reason}")

    def differences(self) -> list[str]:
        """Return a sentence for each parameter that has another value than was requested."""
        active: dict[str, dict[str, Any]] = {}
        problems: list[str] = []
        for name, parameters in self.asked.items():
            wanted = {item.name: _plain(item.value) for item in parameters}
            names = sorted(self.names(name).union(wanted))
            request = GetParameters.Request(names=names)
            values = self._ask(name, "get_parameters", request, "tell its parameters").values
            found = map(_plain, map(parameter_value_to_python, values))
            active[name] = dict(zip(names, found, strict=False))
            problems += [
                f"{name}: {key} is {active[name].get(key)!r:.200}, not {value!r:.200}"
                for key, value in wanted.items()
                if active[name].get(key) != value
            ]
        if problems:
            content = {name: {"ros__parameters": values} for name, values in active.items()}
            text = yaml.safe_dump(content, sort_keys=False)
            self._record.write_text(text, encoding="utf-8")
        return problems


def _plain(value: Any) -> Any:
    """Return arrays of any kind as lists, other values as they are; None: no such parameter."""
    return value if value is None or isinstance(value, bool | int | float | str) else list(value)


class NodeGroup:
    """Nodes of the graph, wherever they run; the defaults here suit nodes of this process."""

    names: Sequence[str] = NODES
    """In the order of activation."""

    def dead(self) -> Mapping[str, str]:
        """Return the names of the nodes that died, with a sentence that says how."""
        return {}  # nodes of this process die with it

    def prepare(self, manager: LifecycleManager) -> None:
        """Make the nodes ready to be configured."""

    def retire(self, manager: LifecycleManager, name: str) -> None:
        """Shut down a node that is no longer needed."""
        manager.change(name, "shutdown")

    @property
    def result(self) -> Result | None:
        """Result of an estimator in this process; None if it is elsewhere and its files have it."""
        return None

    def close(self) -> Sequence[str]:
        """Take the nodes down; return a sentence for each that did not end as it should."""
        return ()


class ComposedNodes(NodeGroup):
    """Nodes in this process, run by the given executor.

    Parameters
    ----------
    context, spinner : where they live
    parameters : ROS parameter file for all of them
    names : which nodes
    """

    def __init__(
        self,
        context: Context,
        spinner: Spinner,
        parameters: Path,
        names: Sequence[str] = NODES,
    ) -> None:
        from armimp_control.node import ImbicControllerNode
        from armimp_estimation.node import ImpedanceEstimatorNode
        from armimp_sim.node import ArmSimNode

        classes: Mapping[str, Callable[..., Node]] = {
            SIM_NODE: ArmSimNode,
            CONTROLLER_NODE: ImbicControllerNode,
            ESTIMATOR_NODE: ImpedanceEstimatorNode,
        }
        arguments = ["--ros-args", "--params-file", str(parameters)]
        self.names, self._spinner = names, spinner
        self._nodes: dict[str, Any] = {}
        for name in reversed(names):
            node = classes[name](context=context, cli_args=arguments, use_global_arguments=False)
            self._nodes[name] = node
            spinner.add_node(node)

    @property
    def result(self) -> Result | None:
        """Result of the estimator."""
        found: Result | None = self._nodes[ESTIMATOR_NODE].result
        return found

    def close(self) -> Sequence[str]:
        """Destroy the nodes."""
        for node in self._nodes.values():
            self._spinner.remove_node(node)
            node.destroy_node()
        self._nodes.clear()
        return ()


class SeparateNodes(NodeGroup):
    """Nodes in processes of their own, which end when this process does.

    Parameters
    ----------
    parameters : ROS parameter file for all of them
    log_directory : where their output goes, one file for each
    modules : module of each node, with the first arguments of its process

    Raises
    ------
    GraphError
        If a process can't be started.
    """

    def __init__(
        self,
        parameters: Path,
        log_directory: Path,
        modules: Mapping[str, Sequence[str]] = MODULES,
    ) -> None:
        self._logs = {name: log_directory / f"{name}.log" for name in modules}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._watchdog = ParentWatchdog()
        environment = self._watchdog.environment()
        try:
            log_directory.mkdir(parents=True, exist_ok=True)
            for name, module in modules.items():
                command = [sys.executable, "-m", *module, "--ros-args", NO_LOG_FILES]
                command += ["--params-file", str(parameters)]
                with self._logs[name].open("wb") as log:
                    self.processes[name] = subprocess.Popen(
                        command,
                        stdin=subprocess.DEVNULL,
                        stdout=log,
                        stderr=subprocess.STDOUT,
                        # Ctrl-C is for the orchestrator, which takes the nodes down in order.
                        start_new_session=True,
                        pass_fds=[self._watchdog.child_end],
                        env=environment,
                    )
        except OSError as error:
            self.close()
            raise GraphError(f"the nodes could not be started: {error}") from None

    def dead(self) -> Mapping[str, str]:
        """Say which nodes died, how, and the last line of their output."""
        sentences: dict[str, str] = {}
        signals = {int(one): one.name for one in signal.Signals}
        for name, process in self.processes.items():
            status = process.poll()
            if status is not None:
                how = (
                    f"was killed by {signals.get(-status, f'signal {-status}')}"
                    if status < 0
                    else f"ended with status {status}"
                )
                lines = self._logs[name].read_text(errors="replace").strip().splitlines()
                sentences[name] = f"node {name} {how}" + (f": {lines[-1]}" if lines else "")
        return sentences

    def renice(self, name: str, niceness: int) -> None:
        """Set the niceness of a process just started, and of all threads that it makes.

        Where the system does not permit that, nothing happens.
        """
        number = self.processes[name].pid
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, number, niceness)
            # Where each session is a scheduling group, the niceness above counts only within it.
            Path(f"/proc/{number}/autogroup").write_text(str(niceness), encoding="ascii")

    def close(self) -> Sequence[str]:
        """End the processes by SIGINT and, if that fails, by SIGKILL.

        Return a sentence for each that another signal killed, or that is still there.
        """
        forced: set[str] = set()
        for signal_number in (signal.SIGINT, signal.SIGKILL):
            for name, process in self.processes.items():
                if process.poll() is None:
                    process.send_signal(signal_number)
                    if signal_number == signal.SIGKILL:
                        forced.add(name)
            deadline = time.monotonic() + _TO_END
            for process in self.processes.values():
                with suppress(subprocess.TimeoutExpired):
                    process.wait(max(deadline - time.monotonic(), 0.01))
        self._watchdog.close()
        return [
            sentence
            for name, sentence in self.dead().items()
            if -signal.SIGINT != self.processes[name].returncode < 0 and name not in forced
        ] + [
            f"node {name} could not be ended (process {process.pid})"
            for name, process in self.processes.items()
            if process.returncode is None
        ]


class ExternalNodes(NodeGroup):
    """Nodes that others have started; this process controls their lifecycle only.

    They get the parameters of the experiment over the graph, and are left unconfigured, so that the
    next experiment can use them. Only their heartbeats show when they die.

    Parameters
    ----------
    supervisor : the node that asks and watches
    parameters : parameters that the nodes are given
    """

    def __init__(self, supervisor: Node, parameters: AskedParameters) -> None:
        self._parameters = parameters
        self._monitors = [HeartbeatMonitor(supervisor, name, lambda _: None) for name in self.names]

    def dead(self) -> Mapping[str, str]:
        """Say which nodes have disappeared.

        A silent node is not among them: it may only be stalled, on a machine where its process
        can't be looked up. If it is dead, the middleware soon reports that.
        """
        return {one.name: f"node {one.sentence}" for one in self._monitors if one.presence.gone}

    def prepare(self, manager: LifecycleManager) -> None:
        """Make sure that the nodes are free, and give them their parameters.

        Raises
        ------
        GraphError
            If a node is in use, or finalized, or refuses a parameter.
        """
        for name in manager.names:
            state = manager.state(name)
            if state == "inactive":
                manager.change(name, "cleanup")
            elif state != "unconfigured":
                raise GraphError(
                    f"node {name} is {state}, not unconfigured: it belongs to another experiment,"
                    " or has to be started anew"
                )
        asked, known = self._parameters.asked, self._parameters.names(SIM_NODE)
        if not known.issuperset(item.name for item in asked[SIM_NODE]):
            _leave_to_driver(asked, known)
        for name in manager.names:
            self._parameters.give(name)

    def retire(self, manager: LifecycleManager, name: str) -> None:
        """Bring a node back to the state in which the next experiment expects it.

        Raises
        ------
        GraphError
            If it does not answer or refuses.
        """
        if manager.state(name) == "active":
            manager.change(name, "deactivate")
        if manager.state(name) == "inactive":
            manager.change(name, "cleanup")


def _leave_to_driver(given: dict[str, list[Parameter]], known: set[str]) -> None:
    """Drop parameters that only the simulator has, and metadata that nobody knows of a real rig.

    A driver gets those parameters of the simulator that it has under the same name: the joints, and
    how time passes.
    """
    given[SIM_NODE] = [item for item in given[SIM_NODE] if item.name in known]
    for number, item in enumerate(given.get(ESTIMATOR_NODE, [])):
        if item.name == "metadata":
            metadata = json.loads(item.value)
            for key in ("truth", "torque_uncertainty", *CALIBRATION_KEYS):
                metadata.pop(key, None)
            given[ESTIMATOR_NODE][number] = Parameter("metadata", value=json.dumps(metadata))
