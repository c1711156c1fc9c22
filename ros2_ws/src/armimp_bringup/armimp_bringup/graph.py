"""The node graph: making its nodes, in this process or in others, and taking them down again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from armimp_bringup.resources import config_file
from armimp_common.contract import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE
from armimp_common.domain import DomainClaim
from armimp_common.errors import GraphError
from armimp_common.spin import Spinner

NODES = (SIM_NODE, CONTROLLER_NODE, ESTIMATOR_NODE)
_MODULES = {
    SIM_NODE: "armimp_sim.node",
    CONTROLLER_NODE: "armimp_control.node",
    ESTIMATOR_NODE: "armimp_estimation.node",
}
_PATIENCE = 5.0


class NodeGroup(Protocol):
    """Some nodes of the graph."""

    def dead(self) -> str | None:
        """Say which node died and how; None while all live."""

    def close(self) -> None:
        """Take the nodes down."""


class GraphContext:
    """A ROS context of its own, out of reach and hearing of everything else.

    Discovery stays on the local host, in a domain that no other experiment has, unless the
    environment or the caller chooses otherwise.

    Parameters
    ----------
    domain_id : int or None
        The domain; None takes a free one.
    """

    def __init__(self, domain_id: int | None = None) -> None:
        self.claim = DomainClaim(domain_id)
        # Read by the middleware when the context is made; child processes inherit them.
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_file("fastdds.xml")))
        os.environ["ROS_DOMAIN_ID"] = str(self.claim.domain_id)
        self.context = Context()
        rclpy.init(
            args=[],
            context=self.context,
            domain_id=self.claim.domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )

    def close(self) -> None:
        """Shut the context down and give the domain back."""
        self.context.try_shutdown()
        self.claim.release()

    def __enter__(self) -> GraphContext:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


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

    def dead(self) -> str | None:
        """Nodes of this process die with it: always None."""
        return None

    def close(self) -> None:
        """Destroy the nodes."""
        for node in self._nodes:
            self._spinner.remove_node(node)
            node.destroy_node()
        self._nodes.clear()


class SeparateNodes:
    """Nodes in processes of their own.

    Parameters
    ----------
    parameters : Path
        ROS parameter file for all of them.
    log_directory : Path
        Where their output goes, one file for each.
    names : which nodes
    """

    def __init__(self, parameters: Path, log_directory: Path, names: Sequence[str] = NODES) -> None:
        log_directory.mkdir(parents=True, exist_ok=True)
        self._logs = {name: log_directory / f"{name}.log" for name in names}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        for name in names:
            command = [sys.executable, "-m", _MODULES[name], "--ros-args"]
            command += ["--params-file", str(parameters)]
            with self._logs[name].open("wb") as log:
                self.processes[name] = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    # Ctrl-C is for the orchestrator, which then takes the nodes down in order.
                    start_new_session=True,
                )

    def dead(self) -> str | None:
        """Say which node died, how, and its last words."""
        for name, process in self.processes.items():
            status = process.poll()
            if status is not None:
                how = (
                    f"was killed by {signal.Signals(-status).name}"
                    if status < 0
                    else f"ended with status {status}"
                )
                lines = self._logs[name].read_text(errors="replace").strip().splitlines()
                return f"node {name} {how}" + (f": {lines[-1]}" if lines else "")
        return None

    def close(self) -> None:
        """End the processes: politely, then firmly."""
        for signal_number in (signal.SIGINT, signal.SIGKILL):
            for process in self.processes.values():
                if process.poll() is None:
                    process.send_signal(signal_number)
            deadline = time.monotonic() + _PATIENCE
            for process in self.processes.values():
                try:
                    process.wait(max(deadline - time.monotonic(), 0.01))
                except subprocess.TimeoutExpired:
                    continue
        for name, process in self.processes.items():
            if process.poll() is None:
                raise GraphError(f"node {name} could not be ended (process {process.pid})")
