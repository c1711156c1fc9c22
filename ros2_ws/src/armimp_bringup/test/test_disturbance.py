"""What others on the machine do shows in a loop of plain Python."""

import pytest

from armimp_bringup.disturbance import disturbance, loop_times


def test_it_is_the_median_over_the_fastest() -> None:
    assert disturbance([1.0, 1.0, 1.0]) == pytest.approx(1.0)
    assert disturbance([3.0, 2.0, 9.0]) == pytest.approx(1.5)


def test_each_loop_takes_time() -> None:
    times = loop_times(5)

    assert len(times) == 5
    assert min(times) > 0.0
