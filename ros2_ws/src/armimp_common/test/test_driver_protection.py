"""The driver's own safety: obedience, watchdog, limits, latch."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common.driver_base import MOST_UNDER_WAY, FlowControl
from armimp_common.errors import GraphError
from armimp_common.protection import (
    RAMP_PERIODS,
    WATCHDOG_PERIODS,
    CommandSequence,
    Protection,
    ProtectionLimits,
)


@pytest.fixture
def protection() -> Protection:
    """A protection that has sent a sample, for the first command to answer."""
    protection = Protection(2, ProtectionLimits(position=3.0, velocity=20.0, torque=100.0))
    protection.sample((0.0, 0.0))
    return protection


@pytest.mark.parametrize("bad", [(math.nan, 0.0), (math.inf, 0.0), (101.0, 0.0), (1.0,)])
def test_a_command_that_cannot_be_obeyed_takes_all_torque_away(
    protection: Protection, bad: tuple[float, ...]
) -> None:
    protection.command((3.0, -4.0))
    protection.sample((0.0, 0.0))
    protection.command(bad)
    assert protection.applied == (0.0, 0.0)
    protection.sample((0.0, 0.0))
    protection.command((3.0, -4.0))
    assert protection.applied == (0.0, 0.0)
    assert "cannot be obeyed" in protection.fault


def test_commands_that_answer_ever_older_samples_are_as_good_as_none(
    protection: Protection,
) -> None:
    for _ in range(100):  # samples that nobody was there to answer
        protection.sample((0.0, 0.0))
        protection.period()
    for sample in range(100):
        protection.sample((0.0, 0.0))
        protection.period()
        if sample % 2 == 0:  # each takes two periods
            protection.command((10.0, 0.0))
        if protection.fault:
            break
    assert protection.fault == f"commands are more than {WATCHDOG_PERIODS} periods behind"
    assert sample == 2 * WATCHDOG_PERIODS
    for _ in range(RAMP_PERIODS):
        protection.period()
    assert protection.applied == (0.0, 0.0)


def test_a_controller_may_be_behind_for_a_moment_and_catch_up(protection: Protection) -> None:
    protection.command((10.0, 0.0))
    for _ in range(50):
        for _ in range(WATCHDOG_PERIODS):
            protection.sample((0.0, 0.0))
            protection.period()
        for _ in range(WATCHDOG_PERIODS):
            protection.command((10.0, 0.0))
    assert not protection.fault


def test_a_command_more_than_samples_takes_the_torque_away_unless_it_is_zero(
    protection: Protection,
) -> None:
    protection.command((10.0, 0.0))
    protection.command((0.0, 0.0))
    assert protection.applied == (0.0, 0.0)
    assert not protection.fault
    protection.command((10.0, 0.0))
    assert (str(protection.fault), protection.applied) == ("more commands than samples", (0.0, 0.0))


def test_first_commands_may_answer_any_of_the_last_samples(protection: Protection) -> None:
    for _ in range(100):
        protection.sample((0.0, 0.0))
    for _ in range(1 + WATCHDOG_PERIODS):
        protection.command((10.0, 0.0))
    assert not protection.fault
    protection.command((10.0, 0.0))
    assert "more commands than samples" in protection.fault


@given(
    first=st.integers(1, 1000),
    alone=st.integers(1, 50),
    strays=st.lists(st.integers(0, 1100), min_size=1, max_size=5),
)
def test_whatever_numbers_another_publisher_sends_it_is_found_by_the_next_command(
    first: int, alone: int, strays: list[int]
) -> None:
    sequence = CommandSequence()
    own = list(range(first, first + alone + 2))
    assert not any(sequence.check(number) for number in own[:alone])
    assert any(sequence.check(number) for number in [*strays, *own[alone:]])


def test_a_controller_that_never_numbers_its_commands_is_obeyed_until_one_has_a_number() -> None:
    sequence = CommandSequence()
    assert not any(sequence.check(0) for _ in range(100))
    assert sequence.numbered is False
    assert sequence.check(1) == "command 1 came after a command without a number"


@pytest.mark.parametrize("angles", [(3.1, 0.0), (math.nan, 0.0)])
def test_positions_beyond_their_limit_are_a_fault(
    protection: Protection, angles: tuple[float, float]
) -> None:
    protection.sample(angles)
    assert "position" in protection.fault


def test_velocities_beyond_their_limit_are_a_fault(protection: Protection) -> None:
    for tick in range(10):
        protection.sample((0.019 * tick, 0.0))
    assert not protection.fault
    for tick in range(10):
        protection.sample((0.19 + 0.021 * tick, 0.0))
    assert "velocity" in protection.fault


def test_the_reset_is_refused_under_torque_and_granted_without(protection: Protection) -> None:
    protection.command((1.0, 0.0))
    protection.latch("a reason")
    protection.latch("another")
    with pytest.raises(GraphError, match="not zero"):
        protection.reset()
    assert protection.fault == "a reason"
    protection.command((0.0, 0.0))
    protection.reset()
    protection.sample((0.0, 0.0))
    protection.command((1.0, 0.0))
    assert (protection.applied, protection.fault) == ((1.0, 0.0), "")


def sent(backlog: FlowControl, samples: int) -> FlowControl:
    for _ in range(samples):
        backlog.count_sent()
    return backlog


def test_counts_include_what_came_before_the_first_one_and_never_decrease() -> None:
    backlog = sent(FlowControl(), 30)
    backlog.acknowledge(0)
    sent(backlog, 70).acknowledge(100)
    for foreign in (10, 1_000_000):
        backlog.acknowledge(foreign)
    backlog.acknowledge(100)
    assert not backlog.full
    assert sent(backlog, MOST_UNDER_WAY).full
    backlog.acknowledge(100 + MOST_UNDER_WAY)
    assert not backlog.full


# --- Flow control: the simulator waits for a recorder, and for nobody else ----------------------


@given(st.integers(0, 500), st.lists(st.integers(min_value=0, max_value=400), max_size=60))
def test_never_more_samples_are_under_way_than_the_limit(before: int, batches: list[int]) -> None:
    backlog = sent(FlowControl(), before)
    assert not backlog.full
    backlog.acknowledge(0)
    assert not backlog.full
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
