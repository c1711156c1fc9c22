"""The multisine: whole periods, odd lines with some left out, a low crest factor, the rms asked."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_control import presets
from armimp_control.perturbation import CREST_OF_NOISE, multisine_lines, perturbation

Array = NDArray[np.float64]
NOISE, MULTISINE = (presets.perturbation(3, 2, kind) for kind in ("noise", "multisine"))
DURATIONS = [(50_000, 7142), (12_000, 3000), (2000, 1000)]
"""Samples of some trials, and of the period that each gets."""
PERIOD = DURATIONS[0][1]


def _signal(*, joint: int = 0, trial: int = 1, ticks: int = 50_000, seed: int = 1) -> Array:
    return perturbation(MULTISINE, joint=joint, trial=trial, ticks=ticks, seed=seed)


def _lines(period: Array) -> NDArray[np.intp]:
    amplitudes = np.abs(np.fft.rfft(period))
    return np.flatnonzero(amplitudes > 1e-9 * np.max(amplitudes))


@pytest.mark.parametrize(("ticks", "period"), DURATIONS)
def test_it_repeats_itself_to_the_bit_and_begins_near_zero(ticks: int, period: int) -> None:
    signal = _signal(ticks=ticks)
    assert np.array_equal(signal[period:], signal[:-period])
    assert abs(signal[0]) == np.min(np.abs(signal))


@pytest.mark.parametrize("ticks", [90_000, 60_000, 30_000, 9000, 5000])
def test_a_whole_number_of_periods_fills_the_trial_but_for_a_few_samples(ticks: int) -> None:
    lines, period = multisine_lines(MULTISINE, ticks=ticks, seed=1)
    assert 1000.0 <= period <= 1000.0 * MULTISINE.period
    assert ticks // period >= 4
    assert ticks % period < ticks // period
    assert lines.size >= 3


@pytest.mark.parametrize("ticks", dict(DURATIONS))
def test_crest_factor_is_below_1_8_at_the_rms_of_the_noise(ticks: int) -> None:
    for seed in range(10):
        for joint in range(2):
            signal = _signal(joint=joint, trial=joint + 1, ticks=ticks, seed=seed)
            period = signal[: dict(DURATIONS)[ticks]]
            rms = float(np.sqrt(np.mean(period**2)))
            assert np.max(np.abs(signal)) < 1.8 * rms
            assert rms == pytest.approx(MULTISINE.peak[joint] / CREST_OF_NOISE, rel=0.01)


def test_lines_are_odd_of_equal_amplitude_and_one_of_four_is_left_out() -> None:
    period = _signal()[:PERIOD]
    lines = _lines(period)
    assert (lines % 2 == 1).all()
    amplitudes = np.abs(np.fft.rfft(period))[lines]
    assert np.allclose(amplitudes, amplitudes[0])
    frequencies = lines * 1000.0 / PERIOD
    assert frequencies[0] == pytest.approx(0.140, abs=1e-3)
    assert 14.0 < frequencies[-1] <= 15.0
    left_out = np.setdiff1d(np.arange(1, lines[-1], 2), lines)
    groups, counts = np.unique((left_out - 1) // 8, return_counts=True)
    assert (counts == 1).all()
    assert groups.size >= 13


def test_trials_have_their_own_phases_and_the_same_lines_and_seeds_have_other_ones() -> None:
    first, second = (_signal(trial=trial)[:PERIOD] for trial in (1, 2))
    assert np.array_equal(_lines(first), _lines(second))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.5
    assert not np.array_equal(_lines(first), _lines(_signal(seed=2)[:PERIOD]))
    assert np.array_equal(first, _signal(trial=1)[:PERIOD])
