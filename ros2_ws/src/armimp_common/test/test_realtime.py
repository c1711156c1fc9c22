"""Real time: deadlines, statistics of timing, precedence of a process."""

import gc
import math
import os
import sys
import threading
from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common import realtime
from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.realtime import (
    LATE_NS,
    Durations,
    Pacer,
    TimingMeter,
    realtime_scheduling,
    require_precedence,
)

MS = 1_000_000


def measured(durations: Iterable[int]) -> Durations:
    made = Durations()
    for duration in durations:
        made.add(duration)
    return made


@given(st.lists(st.integers(0, 10**11), min_size=1, max_size=200))
def test_quantiles_are_durations_and_the_longest_is_exact(durations: list[int]) -> None:
    ranked = sorted(durations)
    expected = [ranked[math.ceil(share * len(ranked)) - 1] / 1e9 for share in (0.5, 0.99, 1.0)]
    assert measured(durations).quantiles() == pytest.approx(expected, rel=1e-12)


def test_of_very_many_durations_a_fixed_number_is_kept_and_quantiles_stay_right() -> None:
    durations = np.random.default_rng(1).gamma(3.0, 3e5, 200_000).astype(int)
    made = measured(durations.tolist())
    assert len(made._kept) <= realtime._KEPT
    exact = np.quantile(durations, (0.45, 0.55, 0.98, 0.995)) / 1e9
    p50, p99, longest = made.quantiles()
    assert exact[0] < p50 < exact[1]
    assert exact[2] < p99 < exact[3]
    assert longest == durations.max() / 1e9


def test_late_samples_missed_commands_and_times_are_measured() -> None:
    meter = TimingMeter()
    assert math.isnan(meter.figures().period_p50)
    for tick, lateness in enumerate((0, LATE_NS, LATE_NS + 1, 5 * MS, 10)):
        meter.sent(tick * MS, tick * MS + lateness)
    for latency in (200_000, 300_000, 1_500_000):
        meter.answered(latency)
    meter.missed()
    figures = meter.figures()
    assert (figures.ticks, figures.late, figures.missed) == (5, 2, 1)
    assert (figures.latency_p50, figures.latency_max) == (3e-4, 1.5e-3)
    assert figures.period_max == pytest.approx(5.749999e-3)


class FakeClock:
    """Advances by each sleep and by its overshoot (ns), given for one sleep after the other."""

    def __init__(self, too_long: Iterable[int] = ()) -> None:
        self.ns = 5_000_000_123
        self.sleeps: list[float] = []
        self._too_long: Iterator[int] = iter(too_long)

    def now(self) -> int:
        return self.ns

    def sleep(self, seconds: float) -> None:
        self.sleeps.append(seconds)
        self.ns += round(seconds * 1e9) + next(self._too_long, 0)


def pacer(clock: FakeClock) -> Pacer:
    made = Pacer(now=clock.now, sleep=clock.sleep)
    made.start()
    return made


def test_when_every_sleep_lasts_too_long_expect_no_drift() -> None:
    clock = FakeClock([70_000] * 1000)
    start = clock.ns
    paced = pacer(clock)
    for tick in range(1, 1001):
        paced.wait(tick)
        assert clock.ns == start + tick * MS + 70_000


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


State = tuple[bool, float, int, set[int]]


def state() -> State:
    return (
        gc.isenabled(),
        sys.getswitchinterval(),
        os.sched_getscheduler(0),
        os.sched_getaffinity(0),
    )


@pytest.fixture
def another_thread() -> Iterator[threading.Thread]:
    done = threading.Event()
    thread = threading.Thread(target=done.wait, daemon=True)
    thread.start()
    yield thread
    done.set()
    thread.join()


def test_garbage_is_not_collected_until_precedence_is_given_back() -> None:
    before = state()
    with realtime_scheduling(0):
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        assert sys.getswitchinterval() < before[1]
    assert state() == before
    assert gc.get_freeze_count() == 0


def test_every_thread_gets_the_priority_where_that_is_permitted(
    another_thread: threading.Thread, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os,
        "sched_setscheduler",
        lambda thread, policy, param: asked.append((thread, policy, param.sched_priority)),
    )
    with realtime_scheduling(40):
        fifo = {
            thread
            for thread, policy, priority in asked
            if (policy, priority) == (os.SCHED_FIFO, 40)
        }
        assert {os.getpid(), another_thread.native_id} <= fifo
        asked.clear()
    assert {thread for thread, policy, _ in asked if policy == os.SCHED_OTHER} == fifo


def test_a_priority_that_is_not_permitted_is_refused_beforehand_and_nothing_changes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(thread: int, policy: int, param: os.sched_param) -> None:
        if policy != os.SCHED_OTHER:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    before = state()
    refusal = r"'realtime\.priority' = 40: the system does not permit"
    with pytest.raises(GraphError, match=refusal), realtime_scheduling(40):
        pass
    assert state() == before
    require_precedence(0)
    with pytest.raises(ConfigurationError, match="priority = 40: the system does not permit"):
        require_precedence(40)
