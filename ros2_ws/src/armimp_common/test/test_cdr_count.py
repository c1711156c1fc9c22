"""UInt64 bytes: agreement with rclpy, and refusal of everything else."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import UInt64

from armimp_common.cdr import decode_count, encode_count
from armimp_common.errors import ConfigurationError, MalformedMessageError

counts = st.integers(0, 2**64 - 1)


@given(counts)
def test_bytes_are_those_of_rclpy_and_read_as_what_was_sent(count: int) -> None:
    data = encode_count(count)

    assert data == serialize_message(UInt64(data=count))
    assert deserialize_message(data, UInt64).data == count
    assert decode_count(data) == count


def test_when_big_endian_or_with_a_little_surplus_expect_the_count() -> None:
    assert decode_count(struct.pack(">4sQ", b"\0\0\0\0", 12345)) == 12345
    assert decode_count(encode_count(12345) + bytes(4)) == 12345


@pytest.mark.parametrize("count", [-1, 2**64])
def test_when_a_count_does_not_fit_expect_it_named(count: int) -> None:
    with pytest.raises(ConfigurationError, match=str(count)):
        encode_count(count)


@given(st.binary(max_size=40))
def test_whatever_comes_is_a_count_or_refused(data: bytes) -> None:
    try:
        count = decode_count(data)
    except MalformedMessageError:
        assert not (data[:2] in (b"\0\0", b"\0\1") and 12 <= len(data) <= 27)
    else:
        assert 0 <= count < 2**64


@pytest.mark.parametrize("data", [b"", encode_count(1)[:-1], b"\1" + encode_count(1)[1:]])
def test_when_cut_or_foreign_expect_an_error(data: bytes) -> None:
    with pytest.raises(MalformedMessageError, match="UInt64"):
        decode_count(data)
