"""The gate for commands and the watchdog over samples."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from armimp_common.errors import ConfigurationError
from armimp_control.safety import REFUSED, SafetyConfig, Watchdog, limit_torque

PERIOD = 1e-3
ANY = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
LARGEST = float(np.finfo(np.float64).max)
SMALLEST = float(np.finfo(np.float64).smallest_subnormal)


@settings(deadline=None)
@given(st.lists(ANY, min_size=1, max_size=7), st.floats(1e-6, 1e6))
@example([LARGEST, -LARGEST], 80.0)
@example([SMALLEST, -SMALLEST, 0.0, -0.0], 80.0)
@example([80.0, -80.0], 80.0)
@example([float("nan")] * 7, 80.0)
@example([1.0, float("inf")], 80.0)
@example([float("-inf"), 1.0], 80.0)
def test_whatever_goes_in_what_comes_out_is_finite_and_within_the_limit(
    values: list[float], limit: float
) -> None:
    command = np.array(values)
    result = limit_torque(command, limit)
    assert np.all(np.abs(command) <= limit)
    if np.all(np.isfinite(values)):
        assert np.array_equal(command, np.clip(values, -limit, limit))
        assert result == np.count_nonzero(np.abs(values) > limit)
    else:
        assert result == REFUSED
        assert np.array_equal(command, np.zeros(len(values)))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_one_bad_element_takes_torque_from_all_joints(place: int, bad: float) -> None:
    command = np.array([3.0, -4.0, 500.0])
    command[place] = bad
    assert limit_torque(command, 80.0) == REFUSED
    assert np.array_equal(command, np.zeros(3))


def test_command_at_the_limit_passes_unclipped() -> None:
    command = np.array([80.0, -80.0])
    assert limit_torque(command, 80.0) == 0
    assert np.array_equal(command, [80.0, -80.0])


def test_refusal_can_not_be_mistaken_for_a_number_of_joints() -> None:
    assert REFUSED < 0


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("torque_limit", [0.0, -80.0, float("nan"), float("inf")]),
        ("watchdog_ticks", [0, -5, 101, 10**9, float("nan"), float("inf")]),
        ("ramp_time", [-0.01, 0.051, float("nan"), float("inf")]),
    ],
)
def test_limit_that_would_not_protect_is_refused_with_the_value(
    name: str, values: list[Any]
) -> None:
    for value in values:
        settings: dict[str, Any] = {name: value}
        with pytest.raises(ConfigurationError, match=f"{name} .*{value}"):
            SafetyConfig(**settings)


def _watchdog(*, ticks: int = 5, ramp: float = 0.05) -> Watchdog:
    return Watchdog(SafetyConfig(watchdog_ticks=ticks, ramp_time=ramp), period=PERIOD)


def test_before_the_first_sample_no_torque_is_allowed_and_nothing_has_expired() -> None:
    watchdog = _watchdog()
    assert watchdog.allowance(1e9) == 0.0
    assert not watchdog.expired(1e9)


def test_while_samples_come_all_torque_is_allowed() -> None:
    watchdog = _watchdog()
    for tick in range(1000):
        watchdog.feed(100.0 + tick * PERIOD)
        assert watchdog.allowance(100.0 + (tick + 0.9) * PERIOD) == 1.0
        assert not watchdog.expired(100.0 + (tick + 4.9) * PERIOD)


def test_after_the_patience_torque_ramps_down_to_zero_within_the_ramp() -> None:
    watchdog = _watchdog()
    watchdog.feed(10.0)
    assert not watchdog.expired(10.0049)
    assert watchdog.expired(10.0051)
    assert watchdog.allowance(10.0049) == 1.0
    assert watchdog.allowance(10.005 + 0.0125) == pytest.approx(0.75)
    assert watchdog.allowance(10.005 + 0.0250) == pytest.approx(0.50)
    assert watchdog.allowance(10.005 + 0.0501) == 0.0
    assert watchdog.allowance(1e6) == 0.0


@settings(deadline=None)
@given(
    st.integers(1, 100),
    st.floats(0.0, 0.05),
    st.lists(st.floats(0.0, 0.3), min_size=2, max_size=20),
)
def test_allowance_only_falls_and_is_gone_after_patience_and_ramp(
    ticks: int, ramp: float, times: list[float]
) -> None:
    watchdog = _watchdog(ticks=ticks, ramp=ramp)
    watchdog.feed(0.0)
    shares = [watchdog.allowance(now) for now in sorted(times)]
    assert all(0.0 <= share <= 1.0 for share in shares)
    assert all(one >= later for one, later in pairwise(shares))
    assert watchdog.allowance(ticks * PERIOD + ramp + 1e-9) == 0.0
    assert watchdog.expired(ticks * PERIOD + 1e-9)


def test_without_a_ramp_torque_is_taken_away_at_once() -> None:
    watchdog = _watchdog(ramp=0.0)
    watchdog.feed(0.0)
    assert watchdog.allowance(0.0049) == 1.0
    assert watchdog.allowance(0.0051) == 0.0


def test_clock_that_tells_nonsense_takes_torque_away() -> None:
    watchdog = _watchdog()
    watchdog.feed(0.0)
    assert watchdog.expired(float("nan"))
    assert watchdog.allowance(float("nan")) == 0.0
    watchdog.feed(float("nan"))
    assert watchdog.expired(1.0)
    assert watchdog.allowance(1.0) == 0.0


def test_longest_allowed_setting_is_safe_within_two_hundred_milliseconds() -> None:
    watchdog = _watchdog(ticks=100, ramp=0.05)
    watchdog.feed(0.0)
    assert watchdog.allowance(0.2) == 0.0
