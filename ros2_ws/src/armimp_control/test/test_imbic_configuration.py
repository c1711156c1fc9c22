"""Controller settings that make no sense are refused in one line with the offending value."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError
from armimp_control.laws.imbic import ImbicConfig


def _config() -> ImbicConfig:
    return ImbicConfig(
        target_posture=np.zeros(2),
        target_inertia=np.array([0.2, 0.1]),
        target_damping=np.array([2.0, 1.0]),
        target_stiffness=np.array([10.0, 10.0]),
        model_inertia=0.1 * np.eye(2),
    )


def test_defaults_are_those_of_the_design() -> None:
    config = _config()
    assert (config.lock_frequency, config.lock_damping_ratio) == (100.0, 1.0)
    assert (config.gamma, config.period) == (100.0, 1e-3)
    assert (config.lock_approach, config.lock_dither) == (0.05, 0.0)


@pytest.mark.parametrize("name", ["target_inertia", "target_damping", "target_stiffness"])
@pytest.mark.parametrize("values", [[1.0], [1.0, 2.0, 3.0], [1.0, np.nan], [np.inf, 1.0]])
def test_vector_of_wrong_length_or_not_finite_is_refused(name: str, values: list[float]) -> None:
    changes: dict[str, Any] = {name: np.array(values)}
    with pytest.raises(ConfigurationError, match=f"{name} needs 2 finite values: ") as caught:
        replace(_config(), **changes)
    assert str(values).replace("np.", "") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "matrix", [np.eye(3), np.ones((2, 3)), np.array([[np.nan, 0.0], [0.0, 1.0]])]
)
def test_model_of_wrong_shape_or_not_finite_is_refused(matrix: Any) -> None:
    with pytest.raises(ConfigurationError, match="model_inertia needs 2×2 finite") as caught:
        replace(_config(), model_inertia=matrix)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [0.0, -0.25])
def test_target_without_inertia_is_refused(value: float) -> None:
    with pytest.raises(ConfigurationError, match=f"target_inertia of joint 2 .* got {value}"):
        replace(_config(), target_inertia=np.array([0.2, value]))


@pytest.mark.parametrize(
    "name", ["lock_frequency", "lock_damping_ratio", "lock_approach", "gamma", "period"]
)
@pytest.mark.parametrize("value", [0.0, -1.5, float("nan"), float("inf")])
def test_scalar_that_is_not_positive_is_refused(name: str, value: float) -> None:
    changes: dict[str, Any] = {name: value}
    with pytest.raises(ConfigurationError, match=f"{name} must be positive, got {value}"):
        replace(_config(), **changes)


@pytest.mark.parametrize("value", [-1e-6, float("nan"), float("inf")])
def test_dither_that_is_no_amplitude_is_refused(value: float) -> None:
    with pytest.raises(ConfigurationError, match=f"lock_dither must not be negative, .* {value}"):
        replace(_config(), lock_dither=value)


@pytest.mark.parametrize("value", [0.0, -35.0, 384.7, float("nan"), float("inf")])
def test_dither_whose_second_sine_cannot_be_sampled_is_refused(value: float) -> None:
    """At 1 kHz 1.3 times the frequency must be below 500 Hz."""
    message = rf"lock_dither_frequency must lie between 0 and 384\.6 Hz, got {value}"
    with pytest.raises(ConfigurationError, match=message):
        replace(_config(), lock_dither_frequency=value)


def test_dither_below_half_the_sampling_rate_is_accepted() -> None:
    assert replace(_config(), lock_dither_frequency=384.5).lock_dither_frequency == 384.5
