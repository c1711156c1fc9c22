"""Pacing by absolute deadlines, on a clock that only moves when something sleeps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pytest

from armimp_common.pacing import Pacer

PERIOD = 1_000_000


class FakeClock:
    """Moves by each sleep, and by what the sleeps last too long (ns), one after the other."""

    def __init__(self, too_long: Iterable[int] = ()) -> None:
        self.ns = 5_000_000_123
        self.sleeps: list[float] = []
        self._too_long: Iterator[int] = iter(too_long)

    def now(self) -> int:
        return self.ns

    def sleep(self, seconds: float) -> None:
        self.sleeps.append(seconds)
        self.ns += round(seconds * 1e9) + next(self._too_long, 0)


def pacer(clock: FakeClock, *, spin_ns: int = 0) -> Pacer:
    made = Pacer(PERIOD, spin_ns=spin_ns, now=clock.now, sleep=clock.sleep)
    made.start()
    return made


def test_deadlines_are_whole_periods_after_the_start() -> None:
    clock = FakeClock()
    start = clock.ns
    paced = pacer(clock)
    clock.ns += 77
    assert [paced.deadline_ns(tick) for tick in (0, 1, 50_000)] == [
        *(start, start + PERIOD, start + 50_000 * PERIOD)
    ]


def test_when_every_sleep_lasts_too_long_expect_no_drift() -> None:
    clock = FakeClock([70_000] * 1000)
    start = clock.ns
    paced = pacer(clock)
    for tick in range(1, 1001):
        paced.wait(tick)
        assert clock.ns == start + tick * PERIOD + 70_000


def test_when_a_sleep_ends_too_early_expect_another() -> None:
    clock = FakeClock([-300_000, -50])
    paced = pacer(clock)
    paced.wait(1)
    assert clock.ns == paced.deadline_ns(1)
    assert len(clock.sleeps) == 3


def test_when_held_up_for_several_periods_expect_them_caught_up_without_sleep() -> None:
    clock = FakeClock([3_400_000])
    paced = pacer(clock)
    paced.wait(1)
    late = clock.ns
    for tick in (2, 3, 4):
        paced.wait(tick)
    assert clock.ns == late
    assert len(clock.sleeps) == 1
    paced.wait(5)
    assert clock.ns == paced.deadline_ns(5)


@pytest.mark.parametrize("spin", [100_000, 5 * PERIOD])
def test_the_last_part_of_a_wait_may_be_spent_awake(spin: int) -> None:
    clock = FakeClock([0] if spin < PERIOD else [])
    paced = pacer(clock, spin_ns=spin)
    clock._too_long = iter([0] * (spin < PERIOD) + [20_000] * 1000)

    paced.wait(1)

    asleep = [seconds for seconds in clock.sleeps if seconds > 0.0]
    assert asleep == ([pytest.approx((PERIOD - spin) / 1e9)] if spin < PERIOD else [])
    assert paced.deadline_ns(1) <= clock.ns < paced.deadline_ns(1) + 20_000
