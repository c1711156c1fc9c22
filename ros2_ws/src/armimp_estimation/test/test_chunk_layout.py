"""Chunks of a known layout, taken apart at once: the same as walking from record to record."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_estimation.bags import BagWriter, iterate_messages
from armimp_estimation.bags.chunk_layout import ChunkLayout, ChunkLayouts
from armimp_estimation.bags.message_records import MESSAGE_HEAD
from support.synthetic_bags import synthetic_recording

Record = tuple[int, int, bytes]
"""Channel, log time and content of a message."""

RECORDS = st.lists(
    st.tuples(st.integers(0, 2**16 - 1), st.integers(0, 2**64 - 1), st.binary(max_size=40)),
    min_size=1,
    max_size=12,
)


def chunk(records: list[Record]) -> bytes:
    return b"".join(
        MESSAGE_HEAD.pack(5, 22 + len(content), channel, 7, log_time, 9) + content
        for channel, log_time, content in records
    )


def lengths(records: list[Record]) -> list[int]:
    return [22 + len(content) for _, _, content in records]


@given(RECORDS)
def test_messages_come_out_as_they_were_put_in(records: list[Record]) -> None:
    layout = ChunkLayout(lengths(records))
    assert layout.size == len(chunk(records))
    others = [(channel ^ 1, log_time // 2, content[::-1]) for channel, log_time, content in records]
    for some in (records, others):
        found = layout.split(chunk(some))
        assert found is not None
        channels, log_times, payloads = found
        assert list(zip(channels.tolist(), log_times, payloads, strict=True)) == some


@given(RECORDS, RECORDS)
def test_a_chunk_of_another_layout_is_recognised(one: list[Record], other: list[Record]) -> None:
    layouts = ChunkLayouts()
    layouts.learn(lengths(one))
    if lengths(one) == lengths(other):
        assert layouts.split(chunk(other)) is not None
    else:
        assert layouts.split(chunk(other)) is None


def test_records_of_equal_total_but_other_order_are_another_layout() -> None:
    records = [(1, 2, b"long content"), (3, 4, b"short")]
    layout = ChunkLayout(lengths(records))
    assert layout.split(chunk(records[::-1])) is None


@pytest.mark.parametrize("place", [0, 31 + 5])
def test_a_record_that_is_no_message_is_recognised(place: int) -> None:
    records = [(1, 2, b"first"), (3, 4, b"second")]
    whole = bytearray(chunk(records))
    whole[place] = 4
    assert ChunkLayout(lengths(records)).split(bytes(whole)) is None


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), regular=st.booleans())
def test_a_bag_gives_back_what_was_written_whatever_the_order_of_its_streams(
    tmp_path_factory: pytest.TempPathFactory, seed: int, regular: bool
) -> None:
    messages = list(synthetic_recording(ticks=500).messages)
    if not regular:
        rng = np.random.default_rng(seed)
        for start in range(0, len(messages), 4):
            part = messages[start : start + 4]
            messages[start : start + 4] = [part[i] for i in rng.permutation(len(part))]
    path: Path = tmp_path_factory.mktemp("bag") / "bag"
    with BagWriter(path, metadata={}) as writer:
        for k, (topic, _, raw) in enumerate(messages):
            writer.write(topic, raw, k * 250_000)

    read = list(iterate_messages(path))

    assert read == [(topic, k * 250_000, raw) for k, (topic, _, raw) in enumerate(messages)]


def test_head_is_that_of_the_file_format() -> None:
    assert MESSAGE_HEAD.size == struct.calcsize("<BQHIQQ") == 31
