"""The synchronizer of the recorder: complete samples, in order, and nothing waits for ever."""

from armimp_common.topics import DATA_STREAMS, JOINT_STATES, PERTURBATION
from armimp_estimation.alignment.synchronizer import StreamSynchronizer
from support.streams import fed_synchronizer


def filled(others: int, perturbations: int) -> StreamSynchronizer:
    """A synchronizer with so many numbered messages of each stream."""
    synchronizer, deliver = fed_synchronizer()
    for topic in DATA_STREAMS:
        for number in range(perturbations if topic == PERTURBATION else others):
            deliver[topic](str(number).encode())
    return synchronizer


def test_samples_wait_as_a_whole_for_perturbations_that_are_late() -> None:
    synchronizer = filled(200, perturbations=30)
    taken = synchronizer.take()
    assert all(list(map(int, taken[topic])) == list(range(30)) for topic in DATA_STREAMS)
    for number in range(30, 200):
        synchronizer.receive(str(number).encode())
    rest = synchronizer.take()
    assert all(list(map(int, rest[topic])) == list(range(30, 200)) for topic in DATA_STREAMS)


def test_nothing_waits_for_perturbations_that_stay_away() -> None:
    assert len(filled(10_000, perturbations=0).take()[JOINT_STATES]) == 8000


def test_once_closed_nothing_more_is_taken_and_what_waits_is_kept() -> None:
    synchronizer, deliver = fed_synchronizer()
    for message in (b"1", b"2"):
        for topic in DATA_STREAMS:
            deliver[topic](message)
        synchronizer.close()
    assert not synchronizer.poll()
    assert synchronizer.take() == {topic: [b"1"] for topic in DATA_STREAMS}
