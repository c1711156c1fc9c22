"""Parameters of real nodes: files, command line, runtime changes, locks."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import pytest
import rclpy
from pydantic import Field, model_validator
from rcl_interfaces.msg import ParameterType, SetParametersResult
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from armimp_common.errors import ConfigurationError
from armimp_common.parameters import ParameterSet
from armimp_common.schema import Schema


class Law(Schema):
    gamma: float = Field(default=100.0, gt=0.0, description="velocity feedback gain (rad/s)")
    mass: tuple[float, ...] = (0.2, 0.1)


class Params(Schema):
    joints: tuple[str, ...] = ("shoulder", "elbow")
    masks: tuple[bool, ...] = ()
    steps: tuple[int, ...] = ()
    scales: tuple[float, ...] = ()
    count: int = Field(default=3, ge=1, le=9)
    least: int = Field(default=0, ge=0)
    quiet: bool = False
    mode: Literal["lockstep", "realtime"] = "lockstep"
    law: Law = Law()

    @model_validator(mode="after")
    def _fits(self) -> "Params":
        if len(self.law.mass) != len(self.joints):
            raise ValueError(f"{len(self.law.mass)} masses for {len(self.joints)} joints")
        return self


MakeNode = Callable[..., Node]


@pytest.fixture
def make_node(domain_id: int, tmp_path: Path) -> Iterator[MakeNode]:
    contexts: list[Context] = []
    nodes: list[Node] = []

    def make(text: str = "", *args: str, name: str = "unit") -> Node:
        path = tmp_path / f"{len(contexts)}.yaml"
        path.write_text(text)
        arguments = ["--ros-args", *(["--params-file", str(path)] if text else []), *args]
        context = Context()
        rclpy.init(
            args=arguments,
            context=context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        contexts.append(context)
        nodes.append(Node(name, context=context))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    for context in contexts:
        context.try_shutdown()


def file(*lines: str) -> str:
    return "\n".join(["unit:", "  ros__parameters:", *(f"    {line}" for line in lines)])


def set_parameter(node: Node, name: str, value: object) -> SetParametersResult:
    return node.set_parameters([Parameter(name, value=value)])[0]


def test_when_file_and_command_line_give_values_expect_them(make_node: MakeNode) -> None:
    node = make_node(
        file("law: {gamma: 7, mass: [1, 2]}", "count: 4", "quiet: true", "use_sim_time: false"),
        "-p",
        "count:=5",
    )

    loaded = ParameterSet(node, Params).load()

    assert loaded == Params(law=Law(gamma=7.0, mass=(1.0, 2.0)), count=5, quiet=True)
    assert node.get_parameter("law.gamma").type_ is Parameter.Type.DOUBLE
    assert node.get_parameter("law.mass").type_ is Parameter.Type.DOUBLE_ARRAY


def test_when_arrays_are_empty_expect_them_typed(make_node: MakeNode) -> None:
    node = make_node(file("joints: []", "law: {mass: []}"))

    parameters = ParameterSet(node, Params)

    assert parameters.load() == Params(joints=(), law=Law(mass=()))
    for name, kind in (
        ("joints", Parameter.Type.STRING_ARRAY),
        ("masks", Parameter.Type.BOOL_ARRAY),
        ("steps", Parameter.Type.INTEGER_ARRAY),
        ("scales", Parameter.Type.DOUBLE_ARRAY),
    ):
        assert node.get_parameter(name).type_ is kind
        assert list(node.get_parameter(name).value) == []
    assert set_parameter(node, "scales", [1.5]).successful
    assert parameters.load().scales == (1.5,)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("law: {gama: 1.0}", "parameter 'law.gama' does not exist; .* 'law.gamma'"),
        ("law: {mass: [1.0]}", "parameters do not fit together: 1 masses for 2 joints"),
    ],
)
def test_when_file_is_wrong_expect_configuration_error_on_one_line(
    make_node: MakeNode, line: str, message: str
) -> None:
    node = make_node(file(line))

    with pytest.raises(ConfigurationError, match=f"^{message}[^\n]*$"):
        ParameterSet(node, Params)


def test_descriptors_carry_description_type_and_range(make_node: MakeNode) -> None:
    node = make_node()
    ParameterSet(node, Params)

    gamma = node.describe_parameter("law.gamma")
    assert gamma.description == "velocity feedback gain (rad/s)"
    assert gamma.type == ParameterType.PARAMETER_DOUBLE
    assert not gamma.read_only
    assert gamma.floating_point_range[0].from_value == 0.0
    assert gamma.floating_point_range[0].to_value == float("inf")
    count = node.describe_parameter("count").integer_range[0]
    assert (count.from_value, count.to_value) == (1, 9)
    least = node.describe_parameter("least").integer_range[0]
    assert (least.from_value, least.to_value) == (0, 2**63 - 1)


def test_when_guarded_expect_refusal_of_what_the_schema_refuses(make_node: MakeNode) -> None:
    node = make_node()
    parameters = ParameterSet(node, Params)

    assert set_parameter(node, "law.gamma", 5.0).successful
    assert parameters.load().law.gamma == 5.0
    for name, value, reason in (
        ("law.gamma", 0.0, "greater than 0"),
        ("law.gamma", float("nan"), "law.gamma"),
        ("count", 10, "count"),
        ("mode", "fast", "lockstep"),
        ("joints", ["a"], "2 masses for 1 joints"),
    ):
        result = set_parameter(node, name, value)
        assert not result.successful
        assert reason in result.reason
    assert parameters.load() == Params(law=Law(gamma=5.0))
