"""Precedence of a process: taken, refused, and given back."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import threading
from collections.abc import Iterator

import pytest

from armimp_common import realtime_scheduling
from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.realtime_scheduling import (
    RealtimeScheduling,
    UrgencyParameters,
    require_precedence,
    seldom_collecting,
)

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


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(thread: int, policy: int, param: os.sched_param) -> None:
        if policy != os.SCHED_OTHER:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)


def test_garbage_is_not_collected_until_precedence_is_given_back() -> None:
    before = state()
    taken = RealtimeScheduling(UrgencyParameters())
    assert not gc.isenabled()
    assert gc.get_freeze_count() > 0
    assert sys.getswitchinterval() < before[1]
    taken.give_back()
    assert state() == before
    assert gc.get_freeze_count() == 0


def test_what_is_old_is_left_alone_by_the_collector_until_the_end() -> None:
    before = gc.get_threshold()
    with seldom_collecting():
        assert gc.isenabled()
        assert gc.get_freeze_count() > 0
        assert gc.get_threshold() > before
    assert gc.get_threshold() == before
    assert gc.get_freeze_count() == 0


def test_precedence_of_two_nodes_in_one_process_ends_with_the_first_one() -> None:
    before = state()
    first = RealtimeScheduling(UrgencyParameters())
    second = RealtimeScheduling(UrgencyParameters())
    second.give_back()
    assert not gc.isenabled()
    first.give_back()
    assert state() == before


def test_every_thread_stays_on_the_core_that_is_asked_for(another_thread: threading.Thread) -> None:
    before = state()
    core = max(before[3])
    taken = RealtimeScheduling(UrgencyParameters(cpu=core))
    assert another_thread.native_id is not None
    for thread in (0, another_thread.native_id):
        assert os.sched_getaffinity(thread) == {core}
    taken.give_back()
    assert state() == before
    assert os.sched_getaffinity(another_thread.native_id) == before[3]


def test_a_core_that_does_not_exist_is_refused_and_nothing_changes() -> None:
    before = state()
    with pytest.raises(GraphError, match=r"'realtime\.cpu' = 1023: Invalid argument"):
        RealtimeScheduling(UrgencyParameters(cpu=1023))
    assert state() == before


def test_every_thread_gets_the_priority_where_that_is_permitted(
    another_thread: threading.Thread, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os,
        "sched_setscheduler",
        lambda thread, policy, param: asked.append((thread, policy, param.sched_priority)),
    )
    taken = RealtimeScheduling(UrgencyParameters(priority=40))
    fifo = {
        thread for thread, policy, priority in asked if (policy, priority) == (os.SCHED_FIFO, 40)
    }
    assert {os.getpid(), another_thread.native_id} <= fifo
    asked.clear()
    taken.give_back()
    assert {thread for thread, policy, _ in asked if policy == os.SCHED_OTHER} == fifo


@pytest.mark.usefixtures("refused")
def test_a_priority_that_is_not_permitted_is_refused_and_nothing_changes() -> None:
    before = state()
    with pytest.raises(GraphError, match=r"'realtime\.priority' = 40: the system does not permit"):
        RealtimeScheduling(UrgencyParameters(priority=40))
    assert state() == before


@pytest.mark.usefixtures("refused")
def test_a_priority_that_is_not_permitted_is_found_out_beforehand() -> None:
    require_precedence(0)
    with pytest.raises(ConfigurationError, match="priority = 40: the system does not permit"):
        require_precedence(40)


def test_finding_out_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[int] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda *_: threads.append(threading.get_native_id())
    )
    require_precedence(40)
    assert len(threads) == 1
    assert threads[0] != threading.get_native_id()


def test_waking_up_exactly_may_be_asked_for_anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    realtime_scheduling.wake_up_exactly()
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    realtime_scheduling.wake_up_exactly()
