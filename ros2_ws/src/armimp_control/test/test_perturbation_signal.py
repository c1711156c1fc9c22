"""The random torque: exact peak, reproducible, independent streams, band-limited."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal, stats

from armimp_common.errors import ConfigurationError
from armimp_control.perturbation import PerturbationConfig, perturbation

Array = NDArray[np.float64]
CONFIG = PerturbationConfig(peak=(9.0, 5.4))


def _signal(*, joint: int = 0, trial: int = 1, ticks: int = 5000, seed: int = 1) -> Array:
    return perturbation(CONFIG, joint=joint, trial=trial, ticks=ticks, seed=seed)


@settings(deadline=None)
@given(
    st.floats(1e-3, 100.0),
    st.integers(1, 2000),
    st.integers(0, 2**32),
)
def test_largest_value_is_the_peak_exactly(peak: float, ticks: int, seed: int) -> None:
    config = PerturbationConfig(peak=(peak,))
    values = perturbation(config, joint=0, trial=1, ticks=ticks, seed=seed)
    assert values.shape == (ticks,)
    assert np.max(np.abs(values)) == peak


def test_same_seed_and_trial_give_the_same_bits() -> None:
    assert np.array_equal(_signal(seed=7, trial=2), _signal(seed=7, trial=2))


def test_joint_chooses_the_peak_and_nothing_else() -> None:
    assert _signal(joint=1) == pytest.approx(_signal(joint=0) * (5.4 / 9.0), rel=1e-14)
    assert np.max(np.abs(_signal(joint=1))) == 5.4


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


@pytest.mark.parametrize("cutoff", [5.0, 40.0])
def test_cutoff_is_configurable(cutoff: float) -> None:
    config = PerturbationConfig(peak=(1.0,), cutoff=cutoff)
    values = perturbation(config, joint=0, trial=1, ticks=100_000, seed=1)
    f, density = signal.welch(values, fs=1000.0, nperseg=4096)
    power = np.cumsum(density) / np.sum(density)
    assert np.interp(cutoff, f, power) > 0.95
    assert np.interp(0.5 * cutoff, f, power) == pytest.approx(0.5, abs=0.07)


def test_numbers_behind_the_filter_are_uniform() -> None:
    """A first-order low-pass just below half the rate leaves them nearly as drawn."""
    config = PerturbationConfig(peak=(1.0,), cutoff=499.9, order=1)
    values = perturbation(config, joint=0, trial=1, ticks=100_000, seed=1)
    assert stats.kurtosis(values) == pytest.approx(-1.2, abs=0.05)  # 0 if they were normal
    assert stats.skew(values) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("value", [0.0, -1.5, float("nan"), float("inf")])
def test_impossible_peak_is_refused_with_joint_and_value(value: float) -> None:
    with pytest.raises(ConfigurationError, match=f"peak of joint 2 must be positive, got {value}"):
        PerturbationConfig(peak=(1.0, value))


@pytest.mark.parametrize("value", [0.0, -2.0, 500.0, float("nan"), float("inf")])
def test_impossible_cutoff_is_refused_with_the_value(value: float) -> None:
    with pytest.raises(ConfigurationError, match=f"cutoff {value} Hz"):
        PerturbationConfig(peak=(1.0,), cutoff=value)


@pytest.mark.parametrize("value", [0, -1, 21])
def test_impossible_order_is_refused_with_the_value(value: int) -> None:
    with pytest.raises(ConfigurationError, match=f"order must be 1 to 20, got {value}"):
        PerturbationConfig(peak=(1.0,), order=value)
