"""The timetable of an experiment."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common.status import Phase
from armimp_control.sequence import SequenceParameters, timetable


@settings(deadline=None)
@given(st.floats(0.001, 100.0), st.floats(0.05, 3.0), st.floats(0.05, 3.0), st.integers(1, 7))
def test_segments_follow_each_other_without_gap_or_overlap(
    duration: float, settle: float, rest: float, joints: int
) -> None:
    config = SequenceParameters(duration=duration, settle=settle, rest=rest)
    segments = timetable(config, joints=joints)
    assert segments[0].first == 0
    for one, following in pairwise(segments):
        assert following.first == one.end == one.first + one.ticks
    for segment, seconds in zip(segments, (settle, duration, rest) * joints, strict=True):
        assert segment.ticks >= 1
        assert abs(segment.ticks * 1e-3 - seconds) <= 0.5001e-3


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_every_joint_settles_is_perturbed_and_rests_in_turn(joints: int) -> None:
    segments = timetable(SequenceParameters(duration=2.0), joints=joints)
    assert [segment.phase for segment in segments] == [
        Phase.SETTLE,
        Phase.PERTURB,
        Phase.REST,
    ] * joints
    assert [segment.joint for segment in segments] == [k for k in range(joints) for _ in range(3)]
    assert all(segment.trial == segment.joint + 1 for segment in segments)
