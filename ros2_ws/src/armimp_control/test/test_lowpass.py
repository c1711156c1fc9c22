"""The low-pass against that of scipy, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from armimp_control.perturbation import butterworth, filtered


@pytest.mark.parametrize("order", range(1, 21))
def test_sections_are_those_of_scipy_to_the_last_bit(order: int) -> None:
    for cutoff in (0.5, 2.0, 5.0, 15.0, 40.0, 100.0, 249.0, 250.5, 400.0, 499.9):
        expected = signal.butter(order, cutoff, fs=1000.0, output="sos")
        assert np.array_equal(butterworth(order, cutoff, 1000.0), expected), cutoff


@pytest.mark.parametrize(("order", "cutoff"), [(1, 499.9), (2, 2.0), (7, 40.0), (8, 15.0)])
def test_a_signal_leaves_the_filter_as_it_leaves_that_of_scipy(order: int, cutoff: float) -> None:
    white = np.random.default_rng(3).uniform(-1.0, 1.0, 20_000)
    sections = butterworth(order, cutoff, 1000.0)
    assert np.array_equal(filtered(sections, white), signal.sosfilt(sections, white))
