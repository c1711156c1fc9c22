"""Parameter schemas without ROS: types, bounds, one-line errors, parameter files."""

import math
from enum import Enum
from typing import Annotated, Any, Literal

import pytest
import yaml
from pydantic import BaseModel, Field, field_validator, model_validator

from armimp_common.errors import ConfigurationError
from armimp_common.schema import Schema, build, defaults, flatten, leaves, to_params_yaml


class Sampling(str, Enum):
    BEFORE = "before_update"
    MEAN = "interval_mean"


class Law(Schema):
    gamma: float = Field(default=100.0, gt=0.0, le=1e4, description="feedback gain (rad/s)")
    mass: tuple[float, ...] = Field(default=(0.2, 0.1), description="desired inertia (kg·m²)")
    delay: Annotated[int, Field(ge=1, lt=10)] = 1


class Inner(Schema):
    law: Law = Law(gamma=50.0)
    quiet: bool = False


class Parameters(Schema):
    joints: tuple[str, ...] = ("shoulder", "elbow")
    offset: float = -1e-05
    count: int = 3
    flags: tuple[bool, ...] = ()
    ticks: tuple[int, int] = (1, 2)
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
    def _fits(self) -> "Parameters":
        if self.count > 5 and self.mode == "realtime":
            raise ValueError("count must not exceed 5 in realtime")
        return self


FLAT = {
    "joints": ["shoulder", "elbow"],
    "offset": -1e-05,
    "count": 3,
    "flags": [],
    "ticks": [1, 2],
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
    assert flatten(Parameters()) == FLAT
    assert list(flatten(Parameters())) == list(FLAT)
    assert defaults(Parameters) == FLAT
    assert build(Parameters, FLAT) == Parameters()
    assert build(Parameters, {}) == Parameters()


def test_when_integers_stand_for_doubles_expect_them_accepted() -> None:
    parameters = build(Parameters, {"law.gamma": 7, "law.mass": [1, 2.5]})

    assert parameters.law.gamma == 7.0
    assert isinstance(parameters.law.gamma, float)
    assert parameters.law.mass == (1.0, 2.5)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"law.gamma": -1.0},
            "parameter 'law.gamma' = -1.0: input should be greater than 0",
        ),
        (
            {"law.gamma": math.nan},
            "parameter 'law.gamma' = nan: input should be a finite number",
        ),
        ({"law.gamma": "fast"}, "parameter 'law.gamma' = \"fast\": input should be a valid number"),
        ({"joints": "ab"}, "parameter 'joints' = \"ab\": input should be a valid array"),
        (
            {"law.mass": [1.0, "x"]},
            "parameter 'law.mass[1]' = \"x\": input should be a valid number",
        ),
        ({"count": 1.5}, "parameter 'count' = 1.5: input should be a valid integer"),
        (
            {"mode": "fast"},
            "parameter 'mode' = \"fast\": input should be 'lockstep' or 'realtime'",
        ),
        (
            {"joints": ["a", "a"]},
            "parameter 'joints' = ['a', 'a']: joint names are not distinct",
        ),
        (
            {"count": 6, "mode": "realtime"},
            "parameters do not fit together: count must not exceed 5 in realtime",
        ),
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
        build(Parameters, values)

    assert str(caught.value) == message


def test_when_a_field_without_default_is_not_given_expect_it_named() -> None:
    class Required(Schema):
        name: str
        law: Law

    assert defaults(Required) == {"law.gamma": 100.0, "law.mass": [0.2, 0.1], "law.delay": 1}
    assert build(Required, {"name": "a", "law.delay": 2}).law.delay == 2
    with pytest.raises(ConfigurationError, match="parameter 'name' is missing"):
        build(Required, {"law.delay": 2})


@pytest.mark.parametrize("annotation", [float | None, tuple[float | str, ...], dict[str, float]])
def test_when_ros_has_no_such_type_expect_type_error(annotation: Any) -> None:
    model = type("Odd", (BaseModel,), {"__annotations__": {"field": annotation}})

    with pytest.raises(TypeError, match=r"Odd\.field"):
        leaves(model)


def test_parameter_file_reads_back() -> None:
    odd = Parameters(
        joints=("a: b", '"quoted"', "true", "1", "é\n"), offset=1e300, flags=(True, False), count=-4
    )
    text = to_params_yaml({"arm_sim": Parameters(), "/left/imbic": odd, "empty": Schema()})

    content = yaml.safe_load(text)

    assert list(content) == ["arm_sim", "/left/imbic", "empty"]
    for node, model in (("arm_sim", Parameters()), ("/left/imbic", odd)):
        nested = content[node]["ros__parameters"]
        flat: dict[str, Any] = {}
        for name in FLAT:
            value = nested
            for key in name.split("."):
                value = value[key]
            flat[name] = value
        assert flat == flatten(model)
        assert isinstance(nested["offset"], float), "YAML 1.1 must not take it for a string"
    assert content["empty"] == {"ros__parameters": {}}
