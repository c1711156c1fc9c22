"""What others on the machine do shows in a loop of plain Python."""

import os
from pathlib import Path

import pytest

from armimp_bringup.disturbance import disturbance, loop_times, stolen_time


def test_it_is_the_median_over_the_fastest() -> None:
    assert disturbance([1.0, 1.0, 1.0]) == pytest.approx(1.0)
    assert disturbance([3.0, 2.0, 9.0]) == pytest.approx(1.5)


def test_each_loop_takes_time() -> None:
    times = loop_times(5)

    assert len(times) == 5
    assert min(times) > 0.0


def test_stolen_time_is_that_of_all_processors(tmp_path: Path) -> None:
    statistics = tmp_path / "stat"
    ticks = os.sysconf("SC_CLK_TCK")
    statistics.write_text(f"cpu  1 2 3 4 5 6 7 {3 * ticks} 9 10\ncpu0 1 2 3 4 5 6 7 1 9 10\n")

    assert stolen_time(statistics) == pytest.approx(3.0)
    assert stolen_time() >= 0.0


@pytest.mark.parametrize("text", [None, "", "cpu 1 2 3\n", "cpu a b c d e f g h\n"])
def test_where_it_is_not_counted_none_is_stolen(tmp_path: Path, text: str | None) -> None:
    statistics = tmp_path / "stat"
    if text is not None:
        statistics.write_text(text)

    assert stolen_time(statistics) == 0.0
