"""The sampling rate from stamps: what is taken, and what is found wrong."""

import numpy as np
import pytest

from armimp_common.errors import DataError
from armimp_estimation.alignment.trial_windows import is_customary, judge_stamps, sampling_period
from armimp_estimation.problems import ProblemCode

START = 1_700_000_000_000_000_000


def stamps(rate: float, count: int = 4000) -> np.ndarray:
    made: np.ndarray = START + np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64)
    return made


def codes(values: np.ndarray) -> list[ProblemCode]:
    streams = {"joint_states": values}
    period = sampling_period(streams)
    return [one.code for one in judge_stamps(streams, period, trial=1)]


@pytest.mark.parametrize("rate", [200.0, 333.333333, 500.0, 512.0, 800.0, 1000.0, 2000.0, 4000.0])
def test_a_customary_rate_is_found_and_taken(rate: float) -> None:
    period = sampling_period({"joint_states": stamps(rate)})
    assert 1e9 / period == pytest.approx(rate, rel=1e-6)
    assert codes(stamps(rate)) == []


@pytest.mark.parametrize("rate", [980.0, 1020.0, 900.0])
def test_when_a_rate_is_not_customary_expect_a_problem_with_it(rate: float) -> None:
    assert not is_customary(rate)
    assert codes(stamps(rate)) == [ProblemCode.RATE_UNCUSTOMARY]


def test_when_a_clock_runs_faster_and_faster_expect_a_problem() -> None:
    x = np.arange(4000)
    assert codes(stamps(1000.0) + np.rint(2.5 * x**2).astype(np.int64))[-1:] == [
        ProblemCode.RATE_DRIFTS
    ]


def test_when_stamps_scatter_by_a_third_of_a_period_expect_a_problem_and_not_by_a_fiftieth() -> (
    None
):
    noise = np.random.default_rng(1).normal(size=4000)
    wild = stamps(1000.0) + np.rint(3e5 * np.clip(noise, -1.4, 1.4)).astype(np.int64)
    calm = stamps(1000.0) + np.rint(2e4 * noise).astype(np.int64)
    assert codes(wild) == [ProblemCode.STAMPS_IRREGULAR]
    assert codes(calm) == []


def test_when_streams_have_different_rates_expect_the_one_that_differs() -> None:
    streams = {name: stamps(1000.0) for name in ("a", "b")} | {"c": stamps(995.0)}
    period = sampling_period(streams)
    found = judge_stamps(streams, period, trial=1)
    assert [(one.code, one.values["stream"]) for one in found] == [
        (ProblemCode.STREAM_RATES_DIFFER, "c")
    ]


@pytest.mark.parametrize("rate", [100.0, 8000.0])
def test_when_a_rate_is_out_of_range_expect_it_refused_with_the_rate(rate: float) -> None:
    with pytest.raises(DataError, match=f"{rate:g} Hz"):
        sampling_period({"joint_states": stamps(rate)})


def test_when_stamps_do_not_advance_expect_that_to_be_said() -> None:
    with pytest.raises(DataError, match="joint_states have 1 different stamps"):
        sampling_period({"joint_states": np.zeros(4000, np.int64)})
