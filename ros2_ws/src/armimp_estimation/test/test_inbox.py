"""The inbox of the recorder: whole samples, in order, and nothing waits for ever."""

import pytest

from armimp_common.cdr import JointStateEncoder
from armimp_common.contract import COMMANDS, DATA_STREAMS, JOINT_STATES, PERTURBATION
from armimp_estimation.inbox import Inbox


def filled(**counts: int) -> Inbox:
    """An inbox with so many numbered messages of each stream, by the name of the constant."""
    inbox = Inbox()
    for topic in DATA_STREAMS:
        receive = inbox.receiver(topic)
        for number in range(counts.get(topic, counts["others"])):
            receive(str(number).encode())
    return inbox


def numbers(raws: list[bytes]) -> list[int]:
    return [int(raw) for raw in raws]


def test_samples_are_taken_whole_and_the_rest_later() -> None:
    inbox = filled(others=3, joint_states=5)
    assert inbox.samples == 3

    first = inbox.take()
    for topic in DATA_STREAMS:
        inbox.receiver(topic)(b"9")
    second = inbox.take()

    assert all(numbers(first[topic]) == [0, 1, 2] for topic in DATA_STREAMS)
    assert numbers(second[JOINT_STATES]) == [3]
    assert numbers(second[COMMANDS]) == [9]
    assert inbox.samples == 4


def test_what_is_incomplete_can_be_taken_and_is_made_up_for() -> None:
    inbox = filled(others=3, joint_states=5)

    taken = inbox.take(incomplete=True)
    for topic in DATA_STREAMS:
        for number in range(len(taken[topic]), 6):
            inbox.receiver(topic)(str(number).encode())
    rest = inbox.take()

    assert numbers(taken[JOINT_STATES]) == [0, 1, 2, 3, 4]
    assert numbers(taken[COMMANDS]) == [0, 1, 2]
    assert numbers(rest[JOINT_STATES]) == [5]
    assert numbers(rest[COMMANDS]) == [3, 4, 5]


def test_nothing_waits_for_a_stream_that_fell_silent() -> None:
    inbox = filled(others=200, joint_states=30)

    taken = inbox.take()

    assert len(taken[JOINT_STATES]) == 30
    assert 150 <= len(taken[COMMANDS]) < 200
    assert inbox.samples == 30


def test_newest_stamp_is_that_of_the_last_perturbation_that_waits() -> None:
    inbox = Inbox()
    encode = JointStateEncoder(("a",), "effort").encode
    assert inbox.newest_ns is None
    for stamp_ns in (5, 7):
        inbox.receiver(PERTURBATION)(encode(stamp_ns, [0.0]))
    assert inbox.newest_ns == 7
    inbox.receiver(PERTURBATION)(b"no message")
    assert inbox.newest_ns is None


@pytest.mark.parametrize("last", DATA_STREAMS)
def test_samples_are_told_by_tens_whichever_stream_comes_last(last: str) -> None:
    told: list[int] = []
    inbox = Inbox(told.append)
    receivers = {topic: inbox.receiver(topic) for topic in DATA_STREAMS}
    order = [*(topic for topic in DATA_STREAMS if topic != last), last]

    for _ in range(25):
        for topic in order:
            receivers[topic](b"in turn")
    assert told == [10, 20]
    for topic in order:
        for _ in range(25):
            receivers[topic](b"one stream after the other")

    assert told == [10, 20, 30, 40, 50]


def test_once_closed_nothing_more_is_taken_and_what_waits_is_kept() -> None:
    told: list[int] = []
    inbox = Inbox(told.append)
    receivers = [inbox.receiver(topic) for topic in DATA_STREAMS]
    for receive in receivers * 9:
        receive(b"1")

    inbox.close()
    for receive in receivers * 9:
        receive(b"2")

    assert told == []
    assert inbox.take() == {topic: [b"1"] * 9 for topic in DATA_STREAMS}


@pytest.mark.parametrize("topic", DATA_STREAMS)
def test_once_opened_it_begins_anew(topic: str) -> None:
    inbox = filled(others=3)
    inbox.take()
    inbox.receiver(topic)(b"1")

    inbox.open()

    assert inbox.samples == 0
    assert inbox.take(incomplete=True) == {topic: [] for topic in DATA_STREAMS}
