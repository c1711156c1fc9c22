"""One line for each hazard, with the worst of all tries."""

from support.fault_figures import Figures


def test_worst_of_all_tries_is_told_in_one_line_for_each_hazard() -> None:
    figures = Figures()
    figures.add("recorder killed", loss=(31.0, "ms"))
    figures.add("limiter fed", 100_000, broken_promises=(0, ""))
    figures.add("recorder killed", loss=(49.0, "ms"), time=(0.25, "s"))
    figures.add("recorder killed", loss=(12.0, "ms"))
    figures.add("bag cut", 31)
    assert figures.lines() == [
        "recorder killed, 3 ×: loss 49 ms, time 0.25 s",
        "limiter fed, 100,000 ×: broken promises 0",
        "bag cut, 31 ×",
    ]


def test_nothing_measured_is_no_line() -> None:
    assert Figures().lines() == []
