"""Parameters: their schema without ROS, and those of real nodes: files, changes, refusals."""

import math
from collections.abc import Callable, Iterator
from enum import Enum
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import yaml
from pydantic import BaseModel, Field, field_validator, model_validator
from rcl_interfaces.msg import ParameterType, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from armimp_common.errors import ConfigurationError
from armimp_common.parameters import ParameterSet
from armimp_common.schema import Schema, build, defaults, flatten, leaves, to_params_yaml
from support.graph import joined


class Sampling(str, Enum):
    BEFORE = "before_update"
    MEAN = "interval_mean"


class Law(Schema):
    gamma: float = Field(default=100.0, gt=0.0, description="velocity feedback gain (rad/s)")
    mass: tuple[float, ...] = (0.2, 0.1)
    delay: Annotated[int, Field(ge=1, lt=10)] = 1


class Inner(Schema):
    law: Law = Law(gamma=50.0)
    quiet: bool = False


class Params(Schema):
    joints: tuple[str, ...] = ("shoulder", "elbow")
    offset: float = -1e-05
    count: int = Field(default=3, ge=1, le=9)
    least: int = Field(default=0, ge=0)
    flags: tuple[bool, ...] = ()
    steps: tuple[int, ...] = ()
    scales: tuple[float, ...] = ()
    mode: Literal["lockstep", "realtime"] = "lockstep"
    sampling: Sampling = Sampling.BEFORE
    inner: Inner = Inner()
    law: Law = Field(default_factory=Law)

    @field_validator("joints")
    @classmethod
    def _distinct(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(value)) != len(value):
            raise ValueError("joint names are not distinct")
        return value

    @model_validator(mode="after")
    def _fits(self) -> "Params":
        if len(self.law.mass) != len(self.joints):
            raise ValueError(f"{len(self.law.mass)} masses for {len(self.joints)} joints")
        return self


FLAT = {
    "joints": ["shoulder", "elbow"],
    "offset": -1e-05,
    "count": 3,
    "least": 0,
    "flags": [],
    "steps": [],
    "scales": [],
    "mode": "lockstep",
    "sampling": "before_update",
    "inner.law.gamma": 50.0,
    "inner.law.mass": [0.2, 0.1],
    "inner.law.delay": 1,
    "inner.quiet": False,
    "law.gamma": 100.0,
    "law.mass": [0.2, 0.1],
    "law.delay": 1,
}


def test_nested_fields_become_dotted_names_in_order() -> None:
    assert flatten(Params()) == FLAT
    assert list(flatten(Params())) == list(FLAT)
    assert defaults(Params) == FLAT
    assert build(Params, FLAT) == Params()
    assert build(Params, {}) == Params()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"law.gamma": -1.0}, "parameter 'law.gamma' = -1.0: input should be greater than 0"),
        ({"law.gamma": math.nan}, "parameter 'law.gamma' = nan: input should be a finite number"),
        (
            {"law.mass": [1.0, "x"]},
            "parameter 'law.mass[1]' = \"x\": input should be a valid number",
        ),
        ({"joints": ["a", "a"]}, "parameter 'joints' = ['a', 'a']: joint names are not distinct"),
        ({"law.mass": [1.0]}, "parameters do not fit together: 1 masses for 2 joints"),
        (
            {"law.gama": 1.0},
            "parameter 'law.gama' does not exist; the nearest valid name is 'law.gamma'",
        ),
    ],
)
def test_when_a_value_is_refused_expect_one_line_with_name_value_and_reason(
    values: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        build(Params, values)

    assert str(caught.value) == message


@pytest.mark.parametrize("annotation", [float | None, tuple[float | str, ...], dict[str, float]])
def test_when_ros_has_no_such_type_expect_type_error(annotation: Any) -> None:
    model = type("Odd", (BaseModel,), {"__annotations__": {"field": annotation}})

    with pytest.raises(TypeError, match=r"Odd\.field"):
        leaves(model)


def test_parameter_file_reads_back() -> None:
    names = ("a: b", '"quoted"', "true", "1", "é\n")
    law = Law(mass=(1.0,) * len(names))
    odd = Params(joints=names, offset=1e300, flags=(True, False), count=4, law=law)
    text = to_params_yaml({"arm_sim": Params(), "/left/imbic": odd, "empty": Schema()})

    content = yaml.safe_load(text)

    assert list(content) == ["arm_sim", "/left/imbic", "empty"]
    for node, model in (("arm_sim", Params()), ("/left/imbic", odd)):
        nested = content[node]["ros__parameters"]
        flat = {name: reduce(getitem, name.split("."), nested) for name in FLAT}
        assert flat == flatten(model)
        assert isinstance(nested["offset"], float), "YAML 1.1 must not take it for a string"
    assert content["empty"] == {"ros__parameters": {}}


MakeNode = Callable[..., Node]


@pytest.fixture
def make_node(domain_id: int, tmp_path: Path) -> Iterator[MakeNode]:
    nodes: list[Node] = []

    def make(text: str = "", *args: str) -> Node:
        path = tmp_path / f"{len(nodes)}.yaml"
        path.write_text(text)
        given = ["--params-file", str(path)] if text else []
        context = joined(domain_id, "--ros-args", *given, *args)
        nodes.append(Node("unit", context=context))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
        node.context.try_shutdown()


def file(*lines: str) -> str:
    return "\n".join(["unit:", "  ros__parameters:", *(f"    {line}" for line in lines)])


def set_parameter(node: Node, name: str, value: object) -> SetParametersResult:
    return node.set_parameters([Parameter(name, value=value)])[0]


def test_when_file_and_command_line_give_values_expect_them(make_node: MakeNode) -> None:
    given = ("law: {gamma: 7, mass: [1, 2]}", "count: 4", "inner: {quiet: true}")
    node = make_node(file(*given, "use_sim_time: false"), "-p", "count:=5")

    loaded = ParameterSet(node, Params).load()

    assert loaded == Params(law=Law(gamma=7.0, mass=(1.0, 2.0)), count=5, inner=Inner(quiet=True))
    assert node.get_parameter("law.gamma").type_ is Parameter.Type.DOUBLE
    assert node.get_parameter("law.mass").type_ is Parameter.Type.DOUBLE_ARRAY


def test_when_arrays_are_empty_expect_them_typed(make_node: MakeNode) -> None:
    node = make_node(file("joints: []", "law: {mass: []}"))

    parameters = ParameterSet(node, Params)

    assert parameters.load() == Params(joints=(), law=Law(mass=()))
    for name, kind in (
        ("joints", Parameter.Type.STRING_ARRAY),
        ("flags", Parameter.Type.BOOL_ARRAY),
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
