"""The node graph: making its nodes, in this process or in others, and taking them down again."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Protocol

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from armimp_bringup.resources import config_file
from armimp_common.domain import DomainClaim
from armimp_common.errors import GraphError
from armimp_common.executor import NO_LOG_FILES, Spinner
from armimp_common.process import ParentWatchdog, reachable_from_outside
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE

NODES = (SIM_NODE, CONTROLLER_NODE, ESTIMATOR_NODE)
MODULES: Mapping[str, Sequence[str]] = {
    SIM_NODE: ("armimp_sim.node",),
    CONTROLLER_NODE: ("armimp_control.node",),
    ESTIMATOR_NODE: ("armimp_estimation.node",),
}
"""Module of each node, with the first arguments of its process."""
_RANGE, _PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
_OLD_RANGE, _DOMAIN = "ROS_LOCALHOST_ONLY", "ROS_DOMAIN_ID"
_PATIENCE = 5.0


class NodeGroup(Protocol):
    """Some nodes of the graph."""

    def dead(self) -> Mapping[str, str]:
        """Names of the nodes that died, with a sentence that says how."""

    def close(self) -> None:
        """Take the nodes down."""


class GraphContext:
    """A ROS context of its own, out of reach and hearing of everything else.

    It lives in a domain that no other experiment has, and other machines cannot reach it, unless
    the environment or the caller chooses otherwise. Child processes inherit all that by environment
    variables, which are as they were after `close`.

    The range of discovery that ROS calls ``LOCALHOST`` is not enough: it finds nobody on other
    machines, but its sockets are open to them.

    Parameters
    ----------
    domain_id : int or None
        The domain; None takes a free one.

    Raises
    ------
    ConfigurationError, GraphError
        If there is no such domain, or it is taken, or ROS cannot be started.
    """

    def __init__(self, domain_id: int | None = None) -> None:
        self.claim = DomainClaim(domain_id)
        # Read by the middleware when the context is made; child processes inherit them.
        variables = {**_reach(), _DOMAIN: str(self.claim.domain_id)}
        self._before = {name: os.environ.get(name) for name in variables}
        _set_variables(variables)
        self.context = Context()
        try:
            self._join()
            if variables[_PROFILES] == _loopback() and self._is_open():
                # The middleware reads profiles once in each process, and had done so before.
                self.context.try_shutdown()
                _set_variables({_RANGE: "LOCALHOST"})
                self.context = Context()
                self._join()
                _set_variables(variables)
        except RuntimeError as error:
            self.close()
            # The errors of rclpy, as with security asked of a middleware that has none.
            raise GraphError(f"ROS cannot be started: {' '.join(str(error).split())}") from None
        except BaseException:
            self.close()
            raise

    def _join(self) -> None:
        rclpy.init(
            # No log files in the home directory, which may be missing or full.
            args=["--ros-args", NO_LOG_FILES],
            context=self.context,
            domain_id=self.claim.domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )

    def _is_open(self) -> bool:
        """Whether other machines can reach this process; there are sockets only with a node."""
        node = Node("armimp_socket_check", context=self.context, use_global_arguments=False)
        try:
            return bool(reachable_from_outside())
        except OSError:  # no Linux
            return True
        finally:
            node.destroy_node()

    def close(self) -> None:
        """Shut the context down, give the domain back, and restore the environment."""
        # A lifecycle node that was destroyed stays in the graph, with all sockets and threads, as
        # long as its services are there, which only the garbage collector finds.
        gc.collect()
        self.context.try_shutdown()
        self.claim.release()
        _set_variables(self._before)

    def __enter__(self) -> GraphContext:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _set_variables(variables: Mapping[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _loopback() -> str:
    return str(config_file("fastdds_loopback.xml"))


def _reach() -> dict[str, str | None]:
    """Variables of the environment that say who can be heard and reached; None: not there."""
    reach, profiles = os.environ.get(_RANGE, "LOCALHOST"), os.environ.get(_PROFILES)
    if profiles is not None:
        return {_RANGE: reach, _PROFILES: profiles}
    if reach == "LOCALHOST":
        # With this range, or the variable that was there before it, the middleware would put
        # transports of its own in the place of those of the profile.
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILES: _loopback(), _OLD_RANGE: None}
    return {_RANGE: reach, _PROFILES: str(config_file("fastdds.xml"))}


class ComposedNodes:
    """Nodes in this process, run by the given executor.

    Parameters
    ----------
    context, spinner : where they live
    parameters : Path
        ROS parameter file for all of them.
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
        self._spinner = spinner
        self._nodes: list[Node] = []
        for name in names:
            node = classes[name](context=context, cli_args=arguments, use_global_arguments=False)
            self._nodes.append(node)
            spinner.add_node(node)

    def dead(self) -> Mapping[str, str]:
        """Nodes of this process die with it: always none."""
        return {}

    def close(self) -> None:
        """Destroy the nodes."""
        for node in self._nodes:
            self._spinner.remove_node(node)
            node.destroy_node()
        self._nodes.clear()


class SeparateNodes:
    """Nodes in processes of their own, which end when this process does.

    Parameters
    ----------
    parameters : Path
        ROS parameter file for all of them.
    log_directory : Path
        Where their output goes, one file for each.
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
        self._forced: set[str] = set()
        self._lifeline: ParentWatchdog | None = ParentWatchdog()
        environment = self._lifeline.environment()
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
                        pass_fds=[self._lifeline.child_end],
                        env=environment,
                    )
        except OSError as error:
            self.close()
            raise GraphError(f"the nodes could not be started: {error}") from None

    def dead(self) -> Mapping[str, str]:
        """Say which nodes died, how, and their last words."""
        sentences: dict[str, str] = {}
        for name, process in self.processes.items():
            status = process.poll()
            if status is not None:
                how = (
                    f"was killed by {signal.Signals(-status).name}"
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
            # Each session may be a group of its own, within which alone that counts.
            Path(f"/proc/{number}/autogroup").write_text(str(niceness), encoding="ascii")

    def crashed(self) -> list[str]:
        """Say which nodes died by a signal that did not come from here, at the very end too."""
        ours = -signal.SIGINT
        return [
            sentence
            for name, sentence in self.dead().items()
            if ours != self.processes[name].returncode < 0 and name not in self._forced
        ]

    def close(self) -> None:
        """End the processes: politely, then firmly."""
        for signal_number in (signal.SIGINT, signal.SIGKILL):
            for name, process in self.processes.items():
                if process.poll() is None:
                    process.send_signal(signal_number)
                    if signal_number == signal.SIGKILL:
                        self._forced.add(name)
            deadline = time.monotonic() + _PATIENCE
            for process in self.processes.values():
                try:
                    process.wait(max(deadline - time.monotonic(), 0.01))
                except subprocess.TimeoutExpired:
                    continue
        if self._lifeline is not None:
            self._lifeline.close()
            self._lifeline = None
        for name, process in self.processes.items():
            if process.poll() is None:
                raise GraphError(f"node {name} could not be ended (process {process.pid})")
