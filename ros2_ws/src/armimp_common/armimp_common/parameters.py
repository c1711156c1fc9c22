"""ROS parameters of a node from its schema: declare, load, and guard them against changes."""

import math
from collections.abc import Callable, Iterable
from typing import Final, Generic

from pydantic import BaseModel
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.executor import refuse_simulated_time
from armimp_common.schema import Leaf, ModelT, build, defaults, flatten, leaves

_OWN_OF_ROS: Final = ("use_sim_time", "start_type_description_service")
_OWN_PREFIX_OF_ROS: Final = "qos_overrides."


class ParameterSet(Generic[ModelT]):
    """The parameters of a node: those of a schema, with the values that its user gives.

    Values come from ``--params-file`` and ``-p``; the others are defaults. Later changes are
    refused if the schema refuses them, and all of them while `locked` gives a reason.

    Parameters
    ----------
    node : the node; a node has one schema
    model : the schema
    default : values to use instead of the defaults of the schema
    locked : returns why nothing may be changed now, or None if changes are welcome

    Raises
    ------
    ConfigurationError
        If ``use_sim_time`` is true; or if a given value belongs to no parameter (misspelt, or meant
        for another node: do not put parameters of one node under ``/**``), has a wrong type, or is
        refused by the schema. Integers may stand for doubles.
    """

    def __init__(
        self,
        node: Node,
        model: type[ModelT],
        default: ModelT | None = None,
        *,
        locked: Callable[[], str | None] = lambda: None,
    ) -> None:
        self._node, self._model, self._locked = node, model, locked
        self._loaded: dict[str, object] = {}
        refuse_simulated_time(node)
        known = leaves(model)
        # rclpy ignores overrides without a parameter, and has no public list of them.
        overrides: dict[str, Parameter] = node._parameter_overrides
        given = {
            name: parameter.value
            for name, parameter in overrides.items()
            if not (
                name in _OWN_OF_ROS
                or name.startswith(_OWN_PREFIX_OF_ROS)
                or (node.has_parameter(name) and name not in known)
            )
        }
        values = {**(defaults(model) if default is None else flatten(default)), **given}
        instance = build(model, values)
        # The type is declared and the value set afterwards, since rclpy would infer the type from
        # the value and takes an empty array for one of bytes.
        node.declare_parameters(
            "",
            [(leaf.name, _type(leaf), _descriptor(leaf)) for leaf in known.values()],
            ignore_override=True,
        )
        result = node.set_parameters_atomically(as_parameters(instance))
        if not result.successful:
            raise ConfigurationError(result.reason)
        node.add_on_set_parameters_callback(self._check)

    def load(self) -> ModelT:
        """Return the present values.

        Raises
        ------
        ConfigurationError
            If the schema refuses them; the message names the parameter, its value and the reason.
        """
        self._loaded = self._present()
        return build(self._model, self._loaded)

    def require_unchanged(self) -> None:
        """Refuse to begin if the node shows other parameters than those it has loaded.

        Raises
        ------
        GraphError
            If any were changed since they were loaded; the message names them.
        """
        present = self._present()
        changed = ", ".join(name for name, value in self._loaded.items() if present[name] != value)
        if changed:
            raise GraphError(f"changed since the node was configured: {changed}; clean it up first")

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        if (reason := self._locked()) is not None:
            names = ", ".join(parameter.name for parameter in parameters)
            reason = f"{names} cannot be changed now: {reason}"
            return SetParametersResult(successful=False, reason=reason)
        known = leaves(self._model)
        changes = {p.name: p.value for p in parameters if p.name in known}
        try:
            build(self._model, {**self._present(), **changes})
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _present(self) -> dict[str, object]:
        found: Iterable[Parameter] = self._node.get_parameters(list(leaves(self._model)))
        return {parameter.name: parameter.value for parameter in found}


def as_parameters(instance: BaseModel) -> list[Parameter]:
    """Return all values of a schema as ROS parameters, each of its declared type."""
    known = leaves(type(instance))
    return [Parameter(name, _type(known[name]), value) for name, value in flatten(instance).items()]


def _type(leaf: Leaf) -> Parameter.Type:
    return Parameter.Type[leaf.type_name.upper().replace(" ", "_")]


def _descriptor(leaf: Leaf) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=leaf.description, read_only=False)
    if math.isinf(leaf.minimum) and math.isinf(leaf.maximum):
        return descriptor
    if leaf.type_name == "double":
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=leaf.minimum, to_value=leaf.maximum)
        ]
    if leaf.type_name == "integer":
        first, last = max(leaf.minimum, -(2**63)), min(leaf.maximum, 2**63 - 1)
        descriptor.integer_range = [IntegerRange(from_value=int(first), to_value=int(last))]
    return descriptor
