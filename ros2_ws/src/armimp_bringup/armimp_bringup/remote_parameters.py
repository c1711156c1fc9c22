"""Parameters of nodes as they are over there: to be set, and read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from armimp_common.errors import GraphError
from armimp_common.executor import Spinner
from armimp_common.lifecycle import ask

_PATIENCE = 10.0

Asked = Mapping[str, Sequence[Parameter]]
"""Parameters by the name of the node that is to have them."""


class RemoteParameters:
    """The parameters of one node.

    Parameters
    ----------
    node, spinner : who asks, and what spins it
    name : of the node that is asked

    Raises
    ------
    GraphError
        Here and by every method, if it does not answer.
    """

    def __init__(self, node: Node, spinner: Spinner, name: str) -> None:
        self._name, self._spinner = name, spinner
        # Those of rclpy block for a quarter of a second wherever discovery takes a moment.
        self._list = node.create_client(ListParameters, f"{name}/list_parameters")
        self._get = node.create_client(GetParameters, f"{name}/get_parameters")
        self._set = node.create_client(SetParametersAtomically, f"{name}/set_parameters_atomically")

    def names(self) -> set[str]:
        """Return the names of the parameters that it has."""
        return set(self._ask(self._list, ListParameters.Request()).result.names)

    def values(self, names: Sequence[str]) -> dict[str, Any]:
        """Return the present values of parameters; None for one that it does not have."""
        answer = self._ask(self._get, GetParameters.Request(names=list(names)))
        found = map(parameter_value_to_python, answer.values)
        return {
            name: value
            if value is None or isinstance(value, bool | int | float | str)
            else list(value)
            for name, value in zip(names, found, strict=False)
        }

    def set(self, parameters: Sequence[Parameter]) -> None:
        """Set them all, or none.

        Raises
        ------
        GraphError
            If the node refuses them.
        """
        messages = [parameter.to_parameter_msg() for parameter in parameters]
        answer = self._ask(self._set, SetParametersAtomically.Request(parameters=messages))
        if not answer.result.successful:
            raise GraphError(f"node {self._name} refused its parameters: {answer.result.reason}")

    def _ask(self, client: Client, request: Any) -> Any:
        return ask(
            client,
            request,
            f"node {self._name}",
            "tell or take its parameters",
            spin_until=self._spinner.spin_until,
            timeout=_PATIENCE,
        )


def read_back(nodes: Mapping[str, RemoteParameters], asked: Asked, record: Path) -> list[str]:
    """Compare the parameters of nodes with those that were asked for, and record what they are.

    Parameters
    ----------
    nodes : those that are asked, by name
    asked : what they should be, of each node
    record : file for the parameters that are active, all of each node; written if they differ

    Returns
    -------
    list of str
        A sentence for each parameter that is another.
    """
    active: dict[str, dict[str, Any]] = {}
    problems: list[str] = []
    for name, parameters in asked.items():
        wanted = {item.name: item.value for item in parameters}
        found = active[name] = nodes[name].values(sorted(nodes[name].names().union(wanted)))
        for key, given in wanted.items():
            value = list(given) if isinstance(given, tuple) else given
            if found.get(key) != value:
                problems.append(f"{name}: {key} is {found.get(key)!r:.200}, not {value!r:.200}")
    if problems:
        content = {name: {"ros__parameters": values} for name, values in active.items()}
        record.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return problems
