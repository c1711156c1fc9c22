"""Frequency responses by local polynomials, against systems whose response is known exactly."""

import numpy as np
import pytest

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.local_polynomial import (
    LocalResponse,
    _with_neighbours,
    local_response,
)
from armimp_estimation.periods import Periods
from armimp_estimation.spectra import bins_in_band

RATE = 125.0
SAMPLES = 6144
BAND = (0.122, 15.0)


def white(seed: int, samples: int = SAMPLES) -> FloatArray:
    values: FloatArray = np.random.default_rng(seed).uniform(-1.0, 1.0, samples)
    return values


def polynomials(order: int) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Input, output and response; response and leakage are polynomials in frequency."""
    rng = np.random.default_rng(order)
    source = white(1)
    place = np.linspace(-1.0, 1.0, SAMPLES // 2 + 1)
    response, leakage = (
        np.polyval(rng.standard_normal(order + 1) + 1j * rng.standard_normal(order + 1), place)
        for _ in range(2)
    )
    output = np.fft.irfft(response * np.fft.rfft(source) + 30.0 * leakage, SAMPLES)
    return source, output, np.asarray(response, dtype=np.complex128)


def estimate(source: FloatArray, *outputs: FloatArray) -> LocalResponse:
    bins = bins_in_band(source.size, RATE, *BAND).astype(np.float64)
    return local_response(source, np.stack(outputs), RATE, BAND, bins * RATE / source.size)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_response_and_leakage_that_are_polynomials_are_found_exactly(order: int) -> None:
    source, output, response = polynomials(order)
    found = estimate(source, output)
    bins = np.rint(found.f * SAMPLES / RATE).astype(int)
    np.testing.assert_allclose(found.response[0], response[bins], rtol=1e-9)
    assert np.max(np.abs(found.noise)) < 1e-15 * np.sum(output**2)


def test_bins_are_those_of_the_whole_record_within_the_band() -> None:
    found = estimate(white(1), white(2))
    np.testing.assert_allclose(found.f, np.arange(6, 738) * RATE / SAMPLES, rtol=1e-14)
    assert found.f[0] >= 0.122 > found.f[0] - RATE / SAMPLES
    assert found.f[-1] <= 15.0 < found.f[-1] + RATE / SAMPLES
    np.testing.assert_array_equal(bins_in_band(8, 8.0, 0.0, 100.0), [1, 2, 3])


TIME = np.arange(SAMPLES) / SAMPLES
FEW_LINES = np.sum([np.cos(2.0 * np.pi * k * TIME) for k in range(5, 800, 15)], axis=0)


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (np.zeros(SAMPLES), r"no perturbation between 0\.122 and 15 Hz"),
        (FEW_LINES, "too few spectral lines between"),
    ],
)
def test_an_input_that_is_still_or_has_a_few_lines_only_is_refused_with_the_band(
    source: FloatArray, reason: str
) -> None:
    with pytest.raises(DataError, match=reason):
        estimate(source, white(1))


@pytest.mark.parametrize("samples", [10, 40, 50])
def test_when_the_record_is_too_short_expect_the_number_of_samples(samples: int) -> None:
    with pytest.raises(DataError, match=rf"{samples} samples are too few .* over 25 bins"):
        estimate(white(1, samples), white(2, samples))


@pytest.mark.parametrize("repeated", [0.0, 0.3])
def test_noise_at_lines_includes_what_repeats_and_responses_have_no_transient(
    repeated: float,
) -> None:
    rng = np.random.default_rng(8)
    bins, count = 1024, 6
    spectrum = np.zeros(bins // 2 + 1, dtype=np.complex128)
    lines = np.arange(2, 130)
    spectrum[lines] = np.exp(2j * np.pi * rng.uniform(size=lines.size))
    disturbed = spectrum * (1.0 + 0.2j * np.linspace(0.0, 1.0, spectrum.size))
    added = rng.standard_normal((2, spectrum.size)) * (spectrum != 0.0)
    disturbed = disturbed + repeated * (added[0] + 1j * added[1]) / np.sqrt(2.0)
    source, once = np.fft.irfft(spectrum, bins), np.fft.irfft(disturbed, bins)
    noise = 0.1 * np.std(once) * rng.standard_normal(bins * count)
    whole = np.tile(source, count)
    periods = Periods.of(whole)
    assert periods is not None
    transient = np.std(once) * np.exp(-np.arange(bins * count) / 300.0)
    outputs = np.stack([np.tile(once, count) + noise + transient, noise])
    plain = local_response(whole, outputs, RATE, (0.3, 15.0), np.zeros(0), periods=periods)
    found = plain.with_scatter(slice(0, 1))
    known = 1.0 + 0.2j * found.f / (0.5 * RATE)
    error = np.abs(found.response[0] - known) ** 2

    def mean_ratio(one: LocalResponse) -> float:
        return float(np.mean(error) / np.mean(one.gain * one.noise[0, 0].real))

    assert 0.8 < mean_ratio(found) < 1.25
    assert (mean_ratio(plain) > 10.0) == (repeated > 0.0)
    np.testing.assert_array_equal(found.noise[1, 1], plain.noise[1, 1])


def test_noise_of_a_sweep_includes_what_a_burst_does_in_its_instant() -> None:
    t, rng = np.arange(30_000) / 1000.0, np.random.default_rng(3)
    source = np.sin(2.0 * np.pi * (0.1 + 0.25 * t) * t)  # passes 5.1 Hz after 10 s
    burst = np.exp(-0.5 * ((t - 10.0) / 0.08) ** 2) * np.sin(2.0 * np.pi * 5.0 * t)
    outputs = np.stack([source + 0.01 * rng.standard_normal(t.size) + burst] * 2)
    f: FloatArray = np.arange(15, 440) / 30.0
    plain = local_response(source, outputs, 1000.0, (0.3, 15.0), f, 7)
    found, near = plain.with_scatter(slice(0, 1)), np.abs(f - 5.1) < 1.0
    error = np.abs(found.response[0] - 1.0) ** 2
    assert np.mean(error[near] / plain.variance[0, near]) > 10.0
    assert np.mean(error[near] / found.variance[0, near]) < 2.0
    np.testing.assert_array_equal(found.noise[1, 1], plain.noise[1, 1])


def test_noise_of_sparse_lines_has_no_more_degrees_of_freedom_than_its_windows() -> None:
    noise = np.arange(1.0, 6.0, dtype=np.complex128)[:, None, None]
    for spacing, expected in ((4.0, 3), (1.0, 6), (0.1, 13)):
        freedom = _with_neighbours(noise, spacing * np.arange(5.0), 3, width=0.5)[1]
        assert freedom == expected
