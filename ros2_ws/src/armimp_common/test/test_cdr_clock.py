"""Clock bytes: agreement with rclpy."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from armimp_common.cdr import encode_clock
from armimp_common.errors import ConfigurationError
from armimp_common.status import to_time
from armimp_common.topics import NS_PER_S


@given(st.integers(-(2**31) * NS_PER_S, 2**31 * NS_PER_S - 1))
def test_bytes_are_those_of_rclpy(stamp_ns: int) -> None:
    assert encode_clock(stamp_ns) == serialize_message(Clock(clock=to_time(stamp_ns)))


@pytest.mark.parametrize("stamp_ns", [-(2**31) * NS_PER_S - 1, 2**31 * NS_PER_S])
def test_when_the_seconds_do_not_fit_expect_the_time_named(stamp_ns: int) -> None:
    with pytest.raises(ConfigurationError, match=f"{stamp_ns} ns"):
        encode_clock(stamp_ns)
