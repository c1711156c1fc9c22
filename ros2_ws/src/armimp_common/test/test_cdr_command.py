"""Float64MultiArray bytes: agreement with rclpy, and refusal of everything else."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from armimp_common.cdr import CommandDecoder, CommandEncoder
from armimp_common.errors import MalformedMessageError


def labelled(values: list[float], *labels: str) -> Float64MultiArray:
    dimensions = [
        MultiArrayDimension(label=label, size=len(values), stride=index)
        for index, label in enumerate(labels)
    ]
    return Float64MultiArray(layout=MultiArrayLayout(dim=dimensions), data=values)


@pytest.mark.parametrize("n", range(1, 8))
def test_encoded_bytes_are_those_of_rclpy_with_zero_padding(n: int) -> None:
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
    with pytest.raises(MalformedMessageError):
        decoder.decode(CommandEncoder(3).encode((0.0, 0.0, 0.0), 1))


@pytest.mark.parametrize("count", [0, 1, 3, 7])
def test_when_the_number_of_values_is_wrong_expect_malformed_message(count: int) -> None:
    decoder = CommandDecoder(2)
    decoder.decode(CommandEncoder(2).encode([1.0, 2.0]))

    with pytest.raises(MalformedMessageError, match=f"{count} values for 2 joints"):
        decoder.decode(serialize_message(Float64MultiArray(data=[1.0] * count)))
    with pytest.raises(MalformedMessageError, match="takes 2 numbers"):
        CommandEncoder(2).encode([1.0] * count)


@pytest.mark.parametrize("length", [0, 1, 100])
def test_decode_many_agrees_with_decode(length: int) -> None:
    numbers = np.random.default_rng(length).normal(size=(length, 3))
    plain = [CommandEncoder(3).encode(row) for row in numbers]
    mixed = [
        data if k % 2 else serialize_message(labelled(row.tolist(), "a"))
        for k, (data, row) in enumerate(zip(plain, numbers, strict=True))
    ]

    for messages in (plain, mixed):
        values = CommandDecoder(3).decode_many(messages)
        assert values.shape == (3, length)
        assert values.dtype == np.float64
        assert values.flags.c_contiguous
        assert values.T.tolist() == numbers.tolist()
