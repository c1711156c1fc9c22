"""Flow control: the simulator waits for a recorder, and for nobody else."""

from hypothesis import given
from hypothesis import strategies as st

from armimp_common.driver_base import MOST_UNDER_WAY, FlowControl


def sent(backlog: FlowControl, samples: int) -> FlowControl:
    for _ in range(samples):
        backlog.count_sent()
    return backlog


def test_with_a_recorder_that_falls_behind_the_next_sample_waits() -> None:
    backlog = FlowControl()
    backlog.acknowledge(0)
    assert not sent(backlog, MOST_UNDER_WAY - 1).full
    assert sent(backlog, 1).full
    backlog.acknowledge(25)
    assert not backlog.full


def test_a_count_that_goes_back_is_not_of_the_recorder() -> None:
    backlog = FlowControl()
    backlog.acknowledge(0)
    sent(backlog, 100).acknowledge(90)
    backlog.acknowledge(10)
    assert not backlog.full


def test_a_recorder_that_begins_later_counts_from_there() -> None:
    backlog = sent(FlowControl(), 5 * MOST_UNDER_WAY)
    backlog.acknowledge(0)
    assert not sent(backlog, MOST_UNDER_WAY - 1).full
    assert sent(backlog, 1).full


@given(st.lists(st.integers(min_value=0, max_value=400), max_size=60))
def test_never_more_samples_are_under_way_than_the_limit(batches: list[int]) -> None:
    backlog = FlowControl()
    backlog.acknowledge(0)
    under_way = received = 0
    for batch in batches:
        for _ in range(batch):
            if not backlog.full:
                backlog.count_sent()
                under_way += 1
        assert under_way <= MOST_UNDER_WAY
        received += under_way // 2
        under_way -= under_way // 2
        if received:
            backlog.acknowledge(received)
