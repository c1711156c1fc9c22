"""UInt64 bytes: agreement with rclpy, and refusal of everything else."""

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt64

from armimp_common.cdr import decode_count
from armimp_common.errors import MalformedMessageError


@given(st.integers(0, 2**64 - 1))
def test_what_rclpy_sends_is_read_also_with_a_little_surplus(count: int) -> None:
    data: bytes = serialize_message(UInt64(data=count))
    for one in (data, data + bytes(4)):
        assert decode_count(one) == count


@given(st.binary(max_size=40) | st.binary(max_size=26).map(lambda data: b"\0\1" + data))
def test_whatever_comes_is_a_count_or_refused(data: bytes) -> None:
    try:
        count = decode_count(data)
    except MalformedMessageError:
        assert not (data[:2] == b"\0\1" and 12 <= len(data) <= 27)
    else:
        assert 0 <= count < 2**64
