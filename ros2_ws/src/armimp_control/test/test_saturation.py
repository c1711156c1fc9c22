"""Where in a trial commands were clipped."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from armimp_control.safety_limiter import SaturationCounter


def ledger_of(ticks: dict[int, int]) -> SaturationCounter:
    ledger = SaturationCounter()
    for tick, clipped in sorted(ticks.items()):
        ledger.add(tick, clipped)
    return ledger


def intervals(ledger: SaturationCounter) -> list[tuple[int, int]]:
    pairs = [text.split("-") for text in ledger.text.split()]
    return [(int(first), int(last)) for first, last in pairs]


def test_when_there_are_too_many_intervals_expect_the_nearest_to_become_one() -> None:
    ticks = {10 * k: 1 for k in range(SaturationCounter.MOST_INTERVALS)}
    ticks[10 * SaturationCounter.MOST_INTERVALS - 8] = 1
    ledger = ledger_of(ticks)
    found = intervals(ledger)
    assert len(found) == SaturationCounter.MOST_INTERVALS
    assert found[-1] == (
        10 * SaturationCounter.MOST_INTERVALS - 10,
        10 * SaturationCounter.MOST_INTERVALS - 8,
    )
    assert found[:-1] == [(10 * k, 10 * k) for k in range(SaturationCounter.MOST_INTERVALS - 1)]


@given(st.dictionaries(st.integers(0, 2000), st.integers(1, 7), max_size=400))
def test_intervals_hold_every_clipped_tick_in_order_and_are_few(ticks: dict[int, int]) -> None:
    ledger = ledger_of(ticks)
    found = intervals(ledger)
    assert ledger.clipped == sum(ticks.values())
    assert len(found) <= SaturationCounter.MOST_INTERVALS
    assert all(any(first <= tick <= last for first, last in found) for tick in ticks)
    assert all(first in ticks and last in ticks for first, last in found)
    assert all(one[1] + 1 < later[0] for one, later in pairwise(found))
