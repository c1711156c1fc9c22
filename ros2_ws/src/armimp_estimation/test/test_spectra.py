import numpy as np
import pytest
import scipy.signal
from numpy.typing import NDArray

from armimp_estimation.spectra import (
    CrossSpectra,
    WelchConfig,
    cross_spectra,
    segment_averages,
)

FloatArray = NDArray[np.float64]

SMALL = WelchConfig(segment=64, overlap=48, f_low=0.0, f_high=32.0)
RATE = 64.0


def signals(channels: int, samples: int, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    mixing = rng.standard_normal((channels, channels))
    offset = 10.0 * rng.standard_normal((channels, 1))
    return mixing @ rng.standard_normal((channels, samples)) + offset


def spectra_of(x: FloatArray, config: WelchConfig = SMALL, rate: float = RATE) -> CrossSpectra:
    return cross_spectra(x, rate=rate, config=config)


def assert_equals_scipy(x: FloatArray, config: WelchConfig, rate: float) -> None:
    ours = spectra_of(x, config, rate)
    for i in range(len(x)):
        for j in range(len(x)):
            f, expected = scipy.signal.csd(
                x[i],
                x[j],
                fs=rate,
                window="hann",
                nperseg=config.segment,
                noverlap=config.overlap,
                detrend="constant",
            )
            kept = (f > 0.0) & (f >= config.f_low) & (f <= config.f_high)
            np.testing.assert_allclose(ours.f, f[kept], rtol=1e-14)
            size = np.sqrt(ours.power(i) * ours.power(j))
            error = np.abs(ours.matrix[i, j] - expected[kept]) / size
            assert error.max() < 1e-12


@pytest.mark.parametrize("segment", [64, 63])
@pytest.mark.parametrize("overlap", [0, 20, 48])
def test_matrix_equals_that_of_scipy_up_to_the_nyquist_bin(segment: int, overlap: int) -> None:
    config = WelchConfig(segment=segment, overlap=overlap, f_low=0.0, f_high=32.0)
    assert_equals_scipy(signals(3, 500), config, RATE)


def test_averages_scatter_and_correlate_as_white_noise_shows() -> None:
    # 21 segments at 75 % overlap, as the default, only shorter.
    config = WelchConfig(segment=128, overlap=96, f_low=5.0, f_high=58.0)
    bins = 54
    samples = 128 + 20 * 32
    runs = 300
    x = np.random.default_rng(5).standard_normal((2 * runs, samples))
    averages = np.empty((runs, bins), dtype=np.complex128)
    for run in range(runs):
        averages[run] = spectra_of(x[2 * run : 2 * run + 2], config, 128.0).matrix[0, 1]
    power = np.mean(np.abs(averages) ** 2)
    assert segment_averages(WelchConfig(), 21)[0] == pytest.approx(11.18, abs=0.01)
    # E|G_xy|² = G_xx G_yy / n_d for independent signals; G_xx = 2/rate for unit white noise.
    worth, correlation = segment_averages(config, 21)
    assert (2.0 / 128.0) ** 2 / power == pytest.approx(worth, rel=0.03)
    for lag, expected in enumerate(correlation):
        products = averages[:, lag:] * np.conj(averages[:, : averages.shape[1] - lag])
        assert np.mean(products).real / power == pytest.approx(expected, abs=0.02)
