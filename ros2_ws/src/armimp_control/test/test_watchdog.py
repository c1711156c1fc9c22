"""The watchdog over samples."""

from __future__ import annotations

import pytest

from armimp_control.safety_limiter import SafetyParameters
from armimp_control.trial_sequencer import Watchdog

PERIOD = 1e-3


def _watchdog(*, ticks: int = 5, ramp: float = 0.05, slowest: float = PERIOD) -> Watchdog:
    config = SafetyParameters(watchdog_ticks=ticks, ramp_time=ramp)
    return Watchdog(config, slowest_tick=slowest)


def test_after_the_patience_the_ramp_keeps_pace_with_the_clock() -> None:
    watchdog = _watchdog()
    watchdog.feed(10.0)
    assert not watchdog.expired(10.0049)
    assert watchdog.expired(10.0051)
    assert [watchdog.ticks_due(now) for now in (10.0051, 10.0052, 10.0071, 10.0301)] == [
        *(1, 0, 2, 23)
    ]
    assert watchdog.ticks_due(1e6) == 24
    assert watchdog.ticks_due(1e6 + 1.0) == 0


def test_sample_that_comes_back_ends_the_waiting() -> None:
    watchdog = _watchdog()
    watchdog.feed(0.0)
    assert watchdog.ticks_due(0.0201) == 16
    watchdog.feed(0.020)
    assert not watchdog.expired(0.0249)
    assert watchdog.ticks_due(0.0261) == 2


@pytest.mark.parametrize("nonsense", [float("nan"), float("inf")])
def test_clock_that_tells_nonsense_makes_the_whole_ramp_due(nonsense: float) -> None:
    watchdog = _watchdog()
    watchdog.feed(0.0)
    assert watchdog.expired(nonsense)
    assert watchdog.ticks_due(nonsense) == 50


def test_longest_allowed_setting_is_over_within_two_hundred_milliseconds() -> None:
    watchdog = _watchdog(ticks=100, ramp=0.05)
    watchdog.feed(0.0)
    assert watchdog.ticks_due(0.2) == 50


def test_by_default_a_rig_in_lockstep_may_be_silent_for_almost_five_seconds() -> None:
    safety = SafetyParameters()
    watchdog = _watchdog(ticks=safety.watchdog_ticks, slowest=safety.slowest_tick)
    watchdog.feed(100.0)

    assert not watchdog.expired(104.99)
    assert watchdog.expired(105.0)
