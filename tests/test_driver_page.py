"""docs/drivers.md says what the parameters of the driver template are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from armimp_common.schema import build, flatten, leaves
from armimp_driver_template.parameters import DriverParameters

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "drivers.md").read_text(encoding="utf-8")


def dotted(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            found |= dotted(value, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = value
    return found


def rows(group: str) -> dict[str, str]:
    """Default of each parameter in the tables whose names begin so."""
    pattern = rf"^\| `({group}(?:\.(?!py)\w+)?)` \| ([^|]*) \|"
    found = re.findall(pattern, PAGE, flags=re.MULTILINE)
    return {name: default.strip() for name, default in found}


def test_the_page_names_every_parameter_of_calibration_and_mock() -> None:
    known = set(leaves(DriverParameters))
    groups = ("device_names", "encoder", "transducer", "drive", "mock")
    assert {name for group in groups for name in rows(group)} == {
        name for name in known if name.split(".")[0] in groups
    }


@pytest.mark.parametrize("name", [*rows("mock"), *rows("drive"), *rows("transducer")])
def test_the_defaults_of_the_page_are_those_of_the_driver(name: str) -> None:
    written = {**rows("mock"), **rows("drive"), **rows("transducer")}[name]
    value = flatten(DriverParameters())[name]
    if written.startswith("as "):
        assert value == []
        return
    numbers = [float(part.replace("−", "-")) for part in written.split(",")]
    assert np.atleast_1d(value).tolist() == pytest.approx(numbers)


def test_the_example_of_a_calibration_is_one() -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL)
    values = dotted(yaml.safe_load(block)["arm_sim"]["ros__parameters"])
    parameters = build(DriverParameters, {**flatten(DriverParameters()), **values})

    parameters.check()

    assert parameters.names_at_device() == ("axis_2", "axis_1")
    first, second = parameters.encoders()
    # A turn of the motor is 1/80 of a turn of the shoulder, 1/50 of one of the elbow.
    assert first.value(12011 + 4096) == pytest.approx(2.0 * np.pi / 80.0)
    assert second.value(3077 + 4096) == pytest.approx(-2.0 * np.pi / 50.0)
    assert parameters.drives()[1].torque(5.0) == pytest.approx(-0.1)
