"""Perturbations: noise, multisines and optimal ones, and the low-pass of the first."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal

from armimp_common.arrays import FloatArray as Array
from armimp_control import presets
from armimp_control.perturbation import (
    CREST,
    CREST_OF_NOISE,
    JointPrior,
    PerturbationKind,
    PerturbationParameters,
    butterworth,
    crest_factor,
    disturbance,
    filtered,
    multisine_lines,
    perturbation,
)

PRIORS = (
    JointPrior(arm=(0.187, 0.9, 12.0), target=(0.2, 2.0, 10.0)),
    JointPrior(arm=(0.06, 0.29, 3.8), target=(0.1, 1.0, 10.0)),
)
MULTISINE = presets.perturbation(3, 2, "multisine")


def _signal(
    kind: PerturbationKind = "noise",
    *angles: float,
    joint: int = 0,
    trial: int = 0,
    ticks: int = 50_000,
    seed: int = 1,
) -> Array:
    """A perturbation at level 3 with limits of the rms angles, rad, in the trial of its joint."""
    limits = {"angle_limit": angles or (0.0,)}
    parameters = presets.perturbation(3, 2, kind).model_copy(update=limits)
    prior, trial = PRIORS[joint], trial or joint + 1
    return perturbation(parameters, joint=joint, trial=trial, ticks=ticks, seed=seed, prior=prior)


@settings(deadline=None)
@given(
    st.floats(1e-3, 100.0),
    st.integers(1, 2000),
    st.integers(0, 2**32),
)
def test_largest_value_is_the_peak_exactly(peak: float, ticks: int, seed: int) -> None:
    config = PerturbationParameters(peak=(peak,))
    values = perturbation(config, joint=0, trial=1, ticks=ticks, seed=seed, prior=PRIORS[0])
    assert values.shape == (ticks,)
    assert np.max(np.abs(values)) == peak


def test_trials_and_seeds_have_independent_streams() -> None:
    streams = [_signal(trial=trial, seed=seed) for trial in (1, 2) for seed in (1, 2)]
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


@pytest.mark.parametrize("cutoff", [0.5, 2.0, 5.0, 15.0, 40.0, 100.0, 249.0, 250.5, 400.0, 499.9])
def test_the_filter_and_what_leaves_it_are_those_of_scipy_to_the_last_bit(cutoff: float) -> None:
    white = np.random.default_rng(3).uniform(-1.0, 1.0, 20_000)
    sections = butterworth(cutoff, 1000.0)
    assert np.array_equal(sections, signal.butter(8, cutoff, fs=1000.0, output="sos"))
    assert np.array_equal(filtered(sections, white), signal.sosfilt(sections, white))


DURATIONS = [(50_000, 7142), (12_000, 3000), (2000, 1000)]
"""Samples of some trials, and of the period that each gets."""
PERIOD = DURATIONS[0][1]


def _lines_of(period: Array) -> NDArray[np.intp]:
    amplitudes = np.abs(np.fft.rfft(period))
    return np.flatnonzero(amplitudes > 1e-9 * np.max(amplitudes))


@pytest.mark.parametrize(("ticks", "period"), DURATIONS)
def test_multisines_repeat_to_the_bit_and_begin_near_zero(ticks: int, period: int) -> None:
    signal = _signal("multisine", ticks=ticks)
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
    for seed, joint in product(range(10), range(2)):
        signal = _signal("multisine", joint=joint, ticks=ticks, seed=seed)
        rms = float(np.sqrt(np.mean(signal[: dict(DURATIONS)[ticks]] ** 2)))
        assert np.max(np.abs(signal)) < 1.8 * rms
        assert rms == pytest.approx(MULTISINE.peak[joint] / CREST_OF_NOISE, rel=0.01)


def test_lines_are_odd_of_equal_amplitude_and_one_of_four_is_left_out() -> None:
    period = _signal("multisine")[:PERIOD]
    lines = _lines_of(period)
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
    first, second = (_signal("multisine", trial=trial)[:PERIOD] for trial in (1, 2))
    assert np.array_equal(_lines_of(first), _lines_of(second))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.5
    assert not np.array_equal(_lines_of(first), _lines_of(_signal("multisine", seed=2)[:PERIOD]))
    assert np.array_equal(first, _signal("multisine", trial=1)[:PERIOD])


# --- The optimal multisine: more informative about M, B and K within the same limits ------------

ANGLES = (0.044, 0.037)
"""Limits of the rms angle of each joint, rad."""


def _spectrum(period: Array) -> tuple[Array, Array]:
    """Lines (Hz) and their powers."""
    power = 2.0 * np.abs(np.fft.rfft(period) / period.size) ** 2
    lines = np.flatnonzero(power > 1e-12 * np.max(power))
    return np.asarray(1000.0 * lines / period.size), power[lines]


def _worst_variance(period: Array, prior: JointPrior) -> float:
    """Largest of the variances of M, B and K, relative to the prior, up to a common factor."""
    f, power = _spectrum(period)
    s = 2j * np.pi * f
    slopes = np.array(prior.arm)[:, None] * np.stack([s**2, s, np.ones_like(s)])
    weights = power * np.abs(prior.response(f)) ** 2 / disturbance(f, 2.0)
    information = ((slopes * weights) @ slopes.conj().T).real
    return float(np.max(np.diag(np.linalg.inv(information))))


@pytest.mark.parametrize(("ticks", "period"), DURATIONS)
@pytest.mark.parametrize("joint", [0, 1])
def test_an_optimal_multisine_is_more_informative_than_a_flat_one_at_the_same_limits(
    joint: int, ticks: int, period: int
) -> None:
    prior, peak = PRIORS[joint], MULTISINE.peak[joint]
    best = _signal("optimal", *ANGLES, joint=joint, ticks=ticks)[:period]
    flat = _signal("multisine", joint=joint, ticks=ticks)[:period]
    flat *= min(peak / np.max(np.abs(flat)), ANGLES[joint] / prior.rms_angle(*_spectrum(flat)))
    worst = [_worst_variance(one, prior) for one in (best, flat)]
    assert worst[0] < 0.7 * worst[1]


@pytest.mark.parametrize(("ticks", "period"), DURATIONS)
def test_limits_of_torque_angle_and_crest_factor_are_held(ticks: int, period: int) -> None:
    for seed, joint in product(range(4), range(2)):
        whole = _signal("optimal", *ANGLES, joint=joint, ticks=ticks, seed=seed)
        one = whole[:period]
        assert np.array_equal(whole[period:], whole[:-period])
        assert crest_factor(one) < CREST
        torque = np.max(np.abs(one)) / MULTISINE.peak[joint]
        angle = PRIORS[joint].rms_angle(*_spectrum(one)) / ANGLES[joint]
        assert max(torque, angle) == pytest.approx(1.0, abs=1e-9)
        assert min(torque, angle) > 0.75


@pytest.mark.parametrize("kind", ["noise", "multisine"])
def test_other_kinds_are_made_smaller_where_they_move_a_joint_too_far(
    kind: PerturbationKind,
) -> None:
    free, held, wide = _signal(kind), _signal(kind, 0.02), _signal(kind, 0.5)
    assert np.array_equal(wide, free)
    part = 50_000 if kind == "noise" else PERIOD
    assert PRIORS[0].rms_angle(*_spectrum(held[:part])) == pytest.approx(0.02, rel=1e-6)
    assert np.allclose(held / np.max(held), free / np.max(free))
