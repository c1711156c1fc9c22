"""CDR by hand: agreement with rclpy, and refusal of everything that is no such message."""

import struct
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout, UInt64

from armimp_common.cdr import (
    CommandDecoder,
    CommandEncoder,
    JointStateDecoder,
    JointStateEncoder,
    decode_count,
    decode_joint_state,
    encode_count,
    joint_names_of,
    stamp_of,
)
from armimp_common.errors import ConfigurationError, MalformedMessageError
from armimp_common.topics import ValueField

STAMP = 1_234_567_890_123_456_789
NAMES = ["shoulder", "elbow"]
FIELDS: tuple[ValueField, ...] = ("position", "effort")

# Every residue of the name and frame lengths, so that all paddings occur.
NAME_LISTS = [
    [f"{'j' * length}{index}" for index in range(count)]
    for count in range(1, 8)
    for length in range(4)
]
FRAMES = ["", "a", "ab", "abc", "abcd", "base_link"]


def joint_state(names: Sequence[str], frame: str = "", **fields: Sequence[float]) -> JointState:
    message = JointState(name=list(names), **{key: list(v) for key, v in fields.items()})
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(STAMP, 10**9)
    return message


def outcome(decoder: JointStateDecoder, data: bytes) -> tuple[int, bytes] | str:
    """The result bit by bit (NaN included), or the error's text."""
    try:
        stamp, values = decoder.decode(data)
    except MalformedMessageError as error:
        return str(error)
    return stamp, struct.pack(f"{len(values)}d", *values)


@pytest.mark.parametrize("field", FIELDS)
def test_rclpy_reads_what_was_encoded_whatever_the_padding(field: ValueField) -> None:
    for names in NAME_LISTS:
        values = [0.1 * (index + 1) for index in range(len(names))]
        message = joint_state(names, "", **{str(field): values})
        data = JointStateEncoder(names, field).encode(STAMP, values)

        assert deserialize_message(data, JointState) == message
        # rclpy leaves up to eight bytes of garbage at the end.
        surplus = len(serialize_message(message)) - len(data)
        assert surplus in (0, 4, 8)


@pytest.mark.parametrize("frame", FRAMES)
def test_when_rclpy_serialised_with_all_fields_filled_expect_the_field_asked_for(
    frame: str,
) -> None:
    for names in NAME_LISTS:
        count = len(names)
        position, velocity, effort = np.random.default_rng(count).normal(size=(3, count)).tolist()
        message = joint_state(names, frame, position=position, velocity=velocity, effort=effort)
        data = serialize_message(message)

        assert JointStateDecoder(names, "position").decode(data) == (STAMP, tuple(position))
        assert JointStateDecoder(names, "effort").decode(data) == (STAMP, tuple(effort))
        assert decode_joint_state(data) == (STAMP, tuple(names), tuple(position), tuple(effort))
        assert stamp_of(data) == STAMP


@pytest.mark.parametrize("field", FIELDS)
def test_when_truncated_at_any_byte_expect_malformed_message(field: ValueField) -> None:
    names = ["a", "bcdef"]
    data = JointStateEncoder(names, field).encode(STAMP, [1.0, 2.0])
    warm = JointStateDecoder(names, field)
    assert warm.decode(data) == (STAMP, (1.0, 2.0))

    for size in range(len(data)):
        # The rest of the message follows in memory, where reading past the end would find it.
        for piece in (data[:size], memoryview(data)[:size], bytearray(data[:size])):
            for decode in (warm.decode, JointStateDecoder(names, field).decode, joint_names_of):
                with pytest.raises(MalformedMessageError):
                    decode(piece)
            if size < 12:
                with pytest.raises(MalformedMessageError):
                    stamp_of(piece)
            else:
                assert stamp_of(piece) == STAMP


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (joint_state(["shoulder"], position=[1.0]), "lacks joint 'elbow'"),
        (joint_state(["shoulder", "wrist"], position=[1.0, 2.0]), "lacks joint 'elbow'"),
        (joint_state([*NAMES, "wrist"], position=[1.0] * 3), "unknown joint 'wrist'"),
        (joint_state(["elbow", "elbow"], position=[1.0, 2.0]), "joint twice"),
        (joint_state([*NAMES, "elbow"], position=[1.0] * 3), "joint twice"),
        (joint_state([], position=[]), "lacks joint 'shoulder'; it has none"),
        (joint_state(NAMES, position=[1.0]), "1 position values for 2 joints"),
        (joint_state(NAMES, position=[1.0] * 3), "3 position values for 2 joints"),
        (joint_state(NAMES, effort=[1.0, 2.0]), "0 position values for 2 joints"),
        (b"", "0 bytes"),
        (b"\0\1\0", "3 bytes"),
        (b"\0\0\0\0" + bytes(40), "not plain little-endian CDR: header 00000000"),
        (b"\0\7\0\0" + bytes(40), "not plain little-endian CDR"),
        (b"\0\1\0\0" + bytes(8) + b"\xff\xff\xff\xff" + bytes(40), "4294967295 items"),
        (b"\0\1\0\0" + bytes(8) + b"\2\0\0\0ab" + bytes(40), "unterminated string"),
        (b"\0\1\0\0" + bytes(12) + b"\xff\xff\xff\x7f" + bytes(40), "2147483647 items"),
    ],
)
def test_when_joints_lengths_or_bytes_are_wrong_expect_malformed_message(
    message: JointState | bytes, reason: str
) -> None:
    data = message if isinstance(message, bytes) else serialize_message(message)

    with pytest.raises(MalformedMessageError, match=reason):
        JointStateDecoder(NAMES, "position").decode(data)


def test_when_more_than_rounding_follows_expect_malformed_message() -> None:
    data = JointStateEncoder(NAMES, "position").encode(0, [1.0, 2.0])
    decoder = JointStateDecoder(NAMES, "position")

    assert decoder.decode(data + bytes(15)) == (0, (1.0, 2.0))
    with pytest.raises(MalformedMessageError, match="16 bytes too many"):
        decoder.decode(data + bytes(16))


@pytest.mark.parametrize(
    ("stamp", "values"),
    [(0, []), (0, [1.0]), (0, [1.0] * 3), (2**31 * 10**9, [1.0, 2.0]), (-(2**62), [1.0, 2.0])],
)
def test_when_values_or_stamp_do_not_fit_expect_error_on_encoding(
    stamp: int, values: list[float]
) -> None:
    with pytest.raises(MalformedMessageError):
        JointStateEncoder(NAMES, "position").encode(stamp, values)


@pytest.mark.parametrize(
    "names", [[], ["a", "a"], [""], ["a\0b"], ["\ud800"]], ids=["none", "twice", "", "nul", "sur"]
)
def test_when_names_are_unusable_expect_configuration_error(names: list[str]) -> None:
    with pytest.raises(ConfigurationError):
        JointStateEncoder(names, "position")
    with pytest.raises(ConfigurationError):
        JointStateDecoder(names, "effort")


def assert_many_agree(
    decoder: JointStateDecoder | CommandDecoder, messages: list[bytes], joints: int
) -> None:
    numbers, values = decoder.decode_many(messages)
    assert numbers.dtype == np.int64
    assert values.dtype == np.float64
    assert (numbers.shape, values.shape) == ((len(messages),), (joints, len(messages)))
    assert values.flags.c_contiguous
    for k, message in enumerate(messages):
        assert (numbers[k], tuple(values[:, k])) == decoder.decode(message)


@pytest.mark.parametrize("length", [0, 1, 257])
@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1]])
@pytest.mark.parametrize("frames", [[""], ["", "of another length"]])
def test_decode_many_agrees_with_decode(length: int, order: list[int], frames: list[str]) -> None:
    names = ["a", "b", "c"]
    ordered = [names[index] for index in order]
    numbers = np.random.default_rng(length).normal(size=(length, 3)).tolist()
    messages = [
        serialize_message(joint_state(ordered, frames[k % len(frames)], effort=row))
        for k, row in enumerate(numbers)
    ]
    assert_many_agree(JointStateDecoder(names, "effort"), messages, 3)


@pytest.mark.parametrize("place", [0, 7, 19])
def test_when_one_of_many_is_malformed_expect_its_index_named(place: int) -> None:
    messages = [JointStateEncoder(NAMES, "position").encode(k, [1.0, 2.0]) for k in range(20)]
    messages[place] = messages[place][:-1]

    with pytest.raises(MalformedMessageError, match=rf"message {place}: .*truncated"):
        JointStateDecoder(NAMES, "position").decode_many(messages)


@given(data=st.binary(max_size=200))
def test_random_bytes_raise_nothing_but_malformed_message(data: bytes) -> None:
    for candidate in (data, b"\0\1\0\0" + data):
        with pytest.raises(MalformedMessageError):
            JointStateDecoder(NAMES, "position").decode(candidate)
        with suppress(MalformedMessageError):  # or, by chance, they are a command
            assert len(CommandDecoder(2).decode(candidate)[1]) == 2


@given(
    changes=st.lists(st.tuples(st.integers(0, 199), st.integers(0, 255)), max_size=6),
    cut=st.integers(0, 20),
)
def test_when_bytes_are_changed_expect_cached_and_fresh_decoder_to_agree(
    changes: list[tuple[int, int]], cut: int
) -> None:
    names = ["b", "acdef"]
    message = joint_state(
        names[::-1], "xy", position=[2.0, 1.0], velocity=[3.0, 4.0], effort=[6.0, 5.0]
    )
    original = bytes(serialize_message(message))
    mutated = bytearray(original)
    for place, byte in changes:
        mutated[place % len(mutated)] = byte
    del mutated[len(mutated) - cut :]

    for field in FIELDS:
        warm = JointStateDecoder(names, field)
        warm.decode(original)
        # A message that could not be decoded leaves no trace.
        for data in (bytes(mutated), original):
            assert outcome(warm, data) == outcome(JointStateDecoder(names, field), data)


def labelled(values: list[float], *labels: str) -> Float64MultiArray:
    dimensions = [
        MultiArrayDimension(label=label, size=len(values), stride=index)
        for index, label in enumerate(labels)
    ]
    return Float64MultiArray(layout=MultiArrayLayout(dim=dimensions), data=values)


@pytest.mark.parametrize("n", range(1, 8))
def test_encoded_commands_are_those_of_rclpy_with_zero_padding(n: int) -> None:
    values = [0.25 * k - 1 for k in range(n)]
    message = Float64MultiArray(data=values)

    data = CommandEncoder(n).encode(values)

    assert deserialize_message(data, Float64MultiArray) == message
    serialised = bytearray(serialize_message(message))
    serialised[16:20] = bytes(4)  # the only padding
    assert data == bytes(serialised)


def test_the_number_comes_with_the_values_whatever_the_layout() -> None:
    decoder = CommandDecoder(2)
    for data, number in (
        (CommandEncoder(2).encode((1.5, -2.5), 2**32 - 1), 2**32 - 1),
        (CommandEncoder(2).encode((1.5, -2.5)), 0),
        (serialize_message(labelled([1.5, -2.5], "a")), 0),
    ):
        assert decoder.decode(data) == (number, (1.5, -2.5))


@pytest.mark.parametrize("count", [0, 1, 3, 7])
def test_when_the_number_of_values_is_wrong_expect_malformed_message(count: int) -> None:
    decoder = CommandDecoder(2)
    decoder.decode(CommandEncoder(2).encode([1.0, 2.0]))

    with pytest.raises(MalformedMessageError, match=f"{count} values for 2 joints"):
        decoder.decode(serialize_message(Float64MultiArray(data=[1.0] * count)))
    with pytest.raises(MalformedMessageError, match="takes 2 numbers"):
        CommandEncoder(2).encode([1.0] * count)


@pytest.mark.parametrize("length", [0, 1, 100])
def test_decode_many_of_commands_agrees_with_decode(length: int) -> None:
    numbers = np.random.default_rng(length).normal(size=(length, 3))
    plain = [CommandEncoder(3).encode(row, k) for k, row in enumerate(numbers)]
    foreign = [serialize_message(labelled(row.tolist(), "a")) for row in numbers]
    for messages in (plain, foreign, [*plain, *foreign]):
        assert_many_agree(CommandDecoder(3), messages, 3)


@given(st.integers(0, 2**64 - 1))
def test_what_rclpy_sends_is_read_also_with_a_little_surplus(count: int) -> None:
    data: bytes = serialize_message(UInt64(data=count))
    assert encode_count(count) == data
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
