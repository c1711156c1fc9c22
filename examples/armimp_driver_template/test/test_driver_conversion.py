"""Conversion of counts to rad and N·m, of torques to those of the drives, and back."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common.errors import ConfigurationError
from armimp_common.schema import build, flatten
from armimp_driver_template.conversion import BITS, Encoders, Sensors, Wiring
from armimp_driver_template.parameters import DriverParameters, SensorParameters


@given(
    calibration=st.fixed_dictionaries(
        {
            "resolution": st.floats(1e-5, 0.1),
            "zero": st.integers(-40_000, 40_000),
            "sign": st.sampled_from((1, -1)),
            "gear": st.floats(0.1, 200.0),
        }
    ),
    path=st.lists(st.integers(-30_000, 30_000), min_size=1, max_size=30),
)
def test_angles_follow_any_path_whatever_the_calibration(
    calibration: dict[str, Any], path: list[int]
) -> None:
    """Steps of less than half the range, through counters that wrap."""
    told = SensorParameters.model_validate({name: (one,) for name, one in calibration.items()})
    encoder = Encoders("encoder", told, 1)
    count = calibration["zero"]
    for step in path:
        count += step
        assert encoder.angles([count % (1 << BITS)]) == encoder.values([count])
        assert encoder.counts(encoder.values([count])) == (count,)


@given(data=st.data(), names=st.lists(st.text(min_size=1), min_size=1, max_size=7, unique=True))
def test_values_come_back_from_any_order_of_the_device(
    data: st.DataObject, names: list[str]
) -> None:
    device = data.draw(st.permutations(names))
    wiring = Wiring(device, names)
    of_device = [f"value of {name}" for name in device]
    assert wiring.to_joints(of_device) == tuple(f"value of {name}" for name in names)
    assert wiring.to_device(wiring.to_joints(of_device)) == tuple(of_device)


@pytest.mark.parametrize("joints", [("a", "c"), ("a", "a"), ("a",)])
def test_joints_that_the_device_does_not_have_are_refused(joints: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError, match=r"'device_names' is a.*; the device has a, b"):
        Wiring(("a", "b"), joints)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"encoder.resolution": [-0.02]}, r"'encoder.resolution\[0\]' = -0.02: input should be gr"),
        ({"encoder.gear": [0.0]}, r"'encoder.gear\[0\]' = 0.0: input should be greater"),
        ({"encoder.gear": [math.inf]}, "'encoder.gear.*' = inf"),
        ({"drive.sign": [1, 2]}, r"'drive.sign\[1\]' = 2: input should be 1 or -1"),
        ({"device_names": ["m1"]}, "1 device_names for 2 joints"),
    ],
)
def test_an_impossible_calibration_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        build(DriverParameters, {**flatten(DriverParameters()), **values})


def test_calibrations_that_do_not_fit_the_joints_are_refused() -> None:
    three = SensorParameters(resolution=(0.02,), zero=(1, 2, 3))
    with pytest.raises(ConfigurationError, match=r"'transducer\.zero' has 3 values for 2 joints"):
        Sensors("transducer", three, 2)
