"""The synchronizer of the recorder: complete samples, in order, and nothing waits for ever."""

import pytest

from armimp_common.topics import COMMANDS, DATA_STREAMS, JOINT_STATES, PERTURBATION
from armimp_estimation.alignment.synchronizer import FETCHED
from support.streams import fed_synchronizer


class Post:
    """A synchronizer, how messages get there, and what it tells."""

    def __init__(self) -> None:
        self.told: list[int] = []
        self.times_behind = 0
        self.synchronizer, self.deliver = fed_synchronizer(self.told.append, self._on_behind)

    def _on_behind(self) -> None:
        self.times_behind += 1

    def deliver_all(self, message: bytes) -> None:
        """A message of each stream, that of the perturbation last."""
        for topic in (*FETCHED, PERTURBATION):
            self.deliver[topic](message)


def filled(**counts: int) -> Post:
    """A synchronizer with so many numbered messages of each stream, by the name of the constant."""
    post = Post()
    for topic in DATA_STREAMS:
        for number in range(counts.get(topic, counts["others"])):
            post.deliver[topic](str(number).encode())
    return post


def numbers(raws: list[bytes]) -> list[int]:
    return [int(raw) for raw in raws]


def test_samples_are_taken_whole_and_the_rest_later() -> None:
    post = filled(others=3, joint_states=5)

    first = post.synchronizer.take()
    post.deliver_all(b"9")
    second = post.synchronizer.take()

    assert all(numbers(first[topic]) == [0, 1, 2] for topic in DATA_STREAMS)
    assert numbers(second[JOINT_STATES]) == [3]
    assert numbers(second[COMMANDS]) == [9]
    assert post.synchronizer.samples == 4


def test_nothing_waits_for_a_stream_that_fell_silent() -> None:
    post = filled(others=200, joint_states=30)

    taken = post.synchronizer.take()

    assert len(taken[JOINT_STATES]) == 30
    assert 150 <= len(taken[COMMANDS]) < 200
    assert post.synchronizer.samples == 30


def test_samples_wait_as_a_whole_for_perturbations_that_are_late() -> None:
    post = filled(others=200, **{PERTURBATION: 30})

    taken = post.synchronizer.take()

    assert all(numbers(taken[topic]) == list(range(30)) for topic in DATA_STREAMS)
    for number in range(30, 200):
        post.deliver[PERTURBATION](str(number).encode())
    rest = post.synchronizer.take()
    assert all(numbers(rest[topic]) == list(range(30, 200)) for topic in DATA_STREAMS)


def test_nothing_waits_for_perturbations_that_stay_away() -> None:
    post = filled(others=10_000, **{PERTURBATION: 0})

    assert len(post.synchronizer.take()[JOINT_STATES]) == 8000


@pytest.mark.parametrize("last", FETCHED)
def test_samples_whose_perturbation_came_first_are_told_with_the_next_one(last: str) -> None:
    post = Post()
    order = [*(topic for topic in DATA_STREAMS if topic != last), last]
    for _ in range(25):
        for topic in order:
            post.deliver[topic](b"in turn")

    assert post.told == [10, 20]
    assert post.times_behind == 2


@pytest.mark.parametrize("late", FETCHED)
def test_samples_whose_perturbation_was_the_last_one_are_told_at_a_look(late: str) -> None:
    post = Post()
    for topic in (*(topic for topic in FETCHED if topic != late), PERTURBATION):
        for _ in range(25):
            post.deliver[topic](b"one stream after the other")
    assert post.told == []
    assert post.times_behind == 1
    assert post.synchronizer.poll()

    for _ in range(25):
        post.deliver[late](b"at last")

    assert not post.synchronizer.poll()
    assert post.told == [20]


def test_once_closed_nothing_more_is_taken_and_what_waits_is_kept() -> None:
    post = Post()
    for _ in range(9):
        post.deliver_all(b"1")

    post.synchronizer.close()
    for _ in range(9):
        post.deliver_all(b"2")

    assert not post.synchronizer.poll()
    post.synchronizer.close()
    assert post.synchronizer.take() == {topic: [b"1"] * 9 for topic in DATA_STREAMS}
    assert post.told == []
