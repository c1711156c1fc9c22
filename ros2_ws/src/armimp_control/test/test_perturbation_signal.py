"""The random torque: exact peak, reproducible, independent streams, band-limited."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal

from armimp_control.perturbation import PerturbationParameters, perturbation

Array = NDArray[np.float64]
CONFIG = PerturbationParameters(peak=(9.0, 5.4))


def _signal(*, joint: int = 0, trial: int = 1, ticks: int = 5000, seed: int = 1) -> Array:
    return perturbation(CONFIG, joint=joint, trial=trial, ticks=ticks, seed=seed)


@settings(deadline=None)
@given(
    st.floats(1e-3, 100.0),
    st.integers(1, 2000),
    st.integers(0, 2**32),
)
def test_largest_value_is_the_peak_exactly(peak: float, ticks: int, seed: int) -> None:
    config = PerturbationParameters(peak=(peak,))
    values = perturbation(config, joint=0, trial=1, ticks=ticks, seed=seed)
    assert values.shape == (ticks,)
    assert np.max(np.abs(values)) == peak


def test_trials_and_seeds_have_independent_streams() -> None:
    streams = [_signal(trial=trial, seed=seed, ticks=50_000) for trial in (1, 2) for seed in (1, 2)]
    correlation = np.corrcoef(streams) - np.eye(4)
    # 50 s at 15 Hz are about 1500 independent values: chance correlation is about 0.026.
    assert np.max(np.abs(correlation)) < 0.12


def test_spectrum_is_flat_below_the_cutoff_and_empty_beyond() -> None:
    f, density = signal.welch(_signal(ticks=200_000), fs=1000.0, nperseg=4096)

    def band(low: float, high: float) -> float:
        return float(np.mean(density[(f >= low) & (f <= high)]))

    reference = band(2.0, 12.0)
    assert band(0.5, 4.0) == pytest.approx(reference, rel=0.2)
    assert band(9.0, 13.0) == pytest.approx(reference, rel=0.2)
    assert band(14.8, 15.2) == pytest.approx(0.5 * reference, rel=0.25)
    assert band(20.0, 21.0) < 0.02 * reference  # (15/20.5)¹⁶ = 0.7 %
    assert band(30.0, 500.0) < 1e-5 * reference
