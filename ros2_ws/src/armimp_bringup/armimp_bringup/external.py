"""Nodes that others have started: by hand, by a launch file, in containers, on other machines."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence

from pydantic import BaseModel
from rclpy.node import Node
from rclpy.parameter import Parameter

from armimp_bringup.remote_parameters import Asked, RemoteParameters
from armimp_common import topics
from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.heartbeat import HeartbeatMonitor, Presence
from armimp_common.lifecycle import LifecycleManager
from armimp_common.parameters import as_parameters

_DOMAIN = "ROS_DOMAIN_ID"


def external_domain(domain_id: int | None) -> int:
    """Return the domain that nodes started by others are in: the given one, or where ROS looks.

    Raises
    ------
    ConfigurationError
        If the variable of the environment holds no number.
    """
    if domain_id is not None:
        return domain_id
    text = os.environ.get(_DOMAIN) or "0"
    if not text.isdecimal():
        raise ConfigurationError(f"{_DOMAIN} is no number: {text!r}")
    return int(text)


class ExternalNodes:
    """Nodes whose processes belong to others; only their lifecycle is led from here.

    They get the parameters of the experiment over the graph, and are given back unconfigured, so
    that the next experiment can use them. Their death shows by their signs of life alone.

    Parameters
    ----------
    supervisor : Node
        Who asks and watches.
    names : which nodes
    """

    def __init__(self, supervisor: Node, names: Sequence[str]) -> None:
        self._watches = [HeartbeatMonitor(supervisor, name, lambda _: None) for name in names]

    def dead(self) -> Mapping[str, str]:
        """Say which nodes were there and are not any more.

        One that is only silent may be stalled, in a place where it can't be looked up; the
        middleware declares it dead soon if it is.
        """
        return {
            watch.name: f"node {watch.sentence}"
            for watch in self._watches
            if watch.presence in (Presence.GONE, Presence.LEFT)
        }

    def close(self) -> None:
        """Leave the processes to those who started them."""

    def prepare(
        self,
        manager: LifecycleManager,
        nodes: Mapping[str, RemoteParameters],
        parameters: Mapping[str, BaseModel],
    ) -> Asked:
        """Make sure that the nodes are free, and give them their parameters, which are returned.

        Raises
        ------
        GraphError
            If a node is in use, or finalized, or refuses a parameter.
        """
        for name in manager.names:
            state = manager.state(name)
            if state == "inactive":
                manager.cleanup(name)
            elif state != "unconfigured":
                raise GraphError(
                    f"node {name} is {state}, not unconfigured: it belongs to another experiment,"
                    " or has to be started anew"
                )
        given = {name: as_parameters(parameters[name]) for name in manager.names}
        if topics.SIM_NODE in given:
            known = nodes[topics.SIM_NODE].names()
            if not known.issuperset(item.name for item in given[topics.SIM_NODE]):
                _leave_to_driver(given, known)
        for name in manager.names:
            nodes[name].set(given[name])
        return given

    def retire(self, manager: LifecycleManager, name: str) -> None:
        """Bring a node back to where the next experiment finds it.

        Raises
        ------
        GraphError
            If it does not answer or refuses.
        """
        if manager.state(name) == "active":
            manager.deactivate(name)
        if manager.state(name) == "inactive":
            manager.cleanup(name)


def _leave_to_driver(given: dict[str, list[Parameter]], known: set[str]) -> None:
    """Keep from a driver what only the simulator has, and from the estimator a truth nobody knows.

    A driver gets those parameters of the simulator that it has by the same name: the joints, and
    how time passes.
    """
    given[topics.SIM_NODE] = [item for item in given[topics.SIM_NODE] if item.name in known]
    for number, item in enumerate(given.get(topics.ESTIMATOR_NODE, [])):
        if item.name == "metadata":
            metadata = json.loads(item.value)
            metadata.pop("truth", None)
            given[topics.ESTIMATOR_NODE][number] = Parameter("metadata", value=json.dumps(metadata))
