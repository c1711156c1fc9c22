"""The timetable of an experiment."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common.errors import ConfigurationError
from armimp_common.status import Phase
from armimp_control.sequence import SequenceConfig, timetable


@settings(deadline=None)
@given(st.floats(0.001, 100.0), st.floats(0.05, 3.0), st.floats(0.05, 3.0), st.integers(1, 7))
def test_segments_follow_each_other_without_gap_or_overlap(
    duration: float, settle: float, rest: float, joints: int
) -> None:
    config = SequenceConfig(duration=duration, settle=settle, rest=rest)
    segments = timetable(config, joints=joints, period=1e-3)
    assert segments[0].first == 0
    for one, following in pairwise(segments):
        assert following.first == one.end == one.first + one.ticks
    for segment, seconds in zip(segments, (settle, duration, rest) * joints, strict=True):
        assert segment.ticks >= 1
        assert abs(segment.ticks * 1e-3 - seconds) <= 0.5001e-3


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_every_joint_settles_is_perturbed_and_rests_in_turn(joints: int) -> None:
    segments = timetable(SequenceConfig(duration=2.0), joints=joints, period=1e-3)
    assert [segment.phase for segment in segments] == [
        Phase.SETTLE,
        Phase.PERTURB,
        Phase.REST,
    ] * joints
    assert [segment.joint for segment in segments] == [k for k in range(joints) for _ in range(3)]
    assert all(segment.trial == segment.joint + 1 for segment in segments)


def test_default_trial_is_fifty_seconds() -> None:
    segments = timetable(SequenceConfig(), joints=2, period=1e-3)
    assert [segment.ticks for segment in segments] == [500, 50_000, 500] * 2
    assert segments[-1].end == 102_000


@pytest.mark.parametrize("value", [0.0, -1.5, float("nan"), float("inf")])
def test_impossible_duration_is_refused_with_the_value(value: float) -> None:
    with pytest.raises(ConfigurationError, match=f"duration must be positive, got {value} s"):
        SequenceConfig(duration=value)


@pytest.mark.parametrize("value", [0.0, 0.049, -1.5, float("nan"), float("inf")])
def test_too_short_a_pause_is_refused_with_the_value(value: float) -> None:
    with pytest.raises(ConfigurationError, match=rf"settle must be at least 0\.05 s, got {value}"):
        SequenceConfig(settle=value)
    with pytest.raises(ConfigurationError, match=rf"rest must be at least 0\.05 s, got {value}"):
        SequenceConfig(rest=value)


def test_perturbation_shorter_than_a_tick_is_refused() -> None:
    config = SequenceConfig(duration=4e-4)
    with pytest.raises(ConfigurationError, match=r"perturb of 0\.0004 s is shorter than a tick"):
        timetable(config, joints=1, period=1e-3)
