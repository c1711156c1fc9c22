"""Parameters of nodes as they are over there: to be set, and read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

from armimp_common.errors import GraphError
from armimp_common.spin import Spinner

_PATIENCE, _ATTEMPTS = 10.0, 5

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
        self._client = AsyncParameterClient(node, name)
        if not self._client.wait_for_services(_PATIENCE):
            raise GraphError(f"node {name} takes no parameters")

    def names(self) -> set[str]:
        """Return the names of the parameters that it has."""
        return set(self._ask(self._client.list_parameters).result.names)

    def values(self, names: Sequence[str]) -> dict[str, Any]:
        """Return the present values of parameters; None for one that it does not have."""
        answer = self._ask(lambda: self._client.get_parameters(list(names)))
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
        answer = self._ask(lambda: self._client.set_parameters_atomically(list(parameters)))
        if not answer.result.successful:
            raise GraphError(f"node {self._name} refused its parameters: {answer.result.reason}")

    def _ask(self, call: Callable[[], Future]) -> Any:
        # An answer gets lost if the node has not discovered this side yet.
        for _ in range(_ATTEMPTS):
            future = call()
            if self._spinner.spin_until(future, _PATIENCE / _ATTEMPTS):
                return future.result()
        raise GraphError(f"node {self._name} does not answer about its parameters")


def read_back(node: Node, spinner: Spinner, asked: Asked, record: Path) -> list[str]:
    """Compare the parameters of nodes with those that were asked for, and record what they are.

    Parameters
    ----------
    node, spinner : who asks, and what spins it
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
        remote = RemoteParameters(node, spinner, name)
        wanted = {item.name: item.value for item in parameters}
        found = active[name] = remote.values(sorted(remote.names().union(wanted)))
        for key, given in wanted.items():
            value = list(given) if isinstance(given, tuple) else given
            if found.get(key) != value:
                problems.append(f"{name}: {key} is {found.get(key)!r:.200}, not {value!r:.200}")
    if problems:
        content = {name: {"ros__parameters": values} for name, values in active.items()}
        record.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return problems
