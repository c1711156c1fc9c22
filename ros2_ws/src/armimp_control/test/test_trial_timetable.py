"""The timetable of an experiment."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

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
