import numpy as np
import pytest
import scipy.signal

from armimp_common.arrays import FloatArray
from armimp_estimation.spectra import BAND, SEGMENT, cross_spectra, segment_averages, step_of

RATE = 30.0
"""So that the band ends at half of it, Hz: the Nyquist frequency, which is not estimated."""


def signals(channels: int, samples: int) -> FloatArray:
    rng = np.random.default_rng(0)
    mixing = rng.standard_normal((channels, channels))
    offset = 10.0 * rng.standard_normal((channels, 1))
    return mixing @ rng.standard_normal((channels, samples)) + offset


@pytest.mark.parametrize("segment", [64, 63, 512])
def test_matrix_equals_that_of_scipy_below_the_nyquist_bin(segment: int) -> None:
    x = signals(3, 8 * segment)
    ours = cross_spectra(x, rate=RATE, segment=segment)
    f, expected = scipy.signal.csd(
        x[:, None],
        x,
        fs=RATE,
        window="hann",
        nperseg=segment,
        noverlap=segment - step_of(segment),
        detrend="constant",
    )
    kept = (f >= BAND[0]) & (f < BAND[1])
    np.testing.assert_allclose(ours.f, f[kept], rtol=1e-14)
    power = np.array([ours.power(i) for i in range(len(x))])
    error = np.abs(ours.matrix - expected[..., kept]) / np.sqrt(power[:, None] * power)
    assert error.max() < 1e-12


def test_averages_scatter_and_correlate_as_white_noise_shows() -> None:
    # 21 segments at 75 % overlap, as the default, only shorter.
    kept = slice(4, 58)
    samples = 128 + 20 * 32
    runs = 300
    x = np.random.default_rng(5).standard_normal((2 * runs, samples))
    averages = np.empty((runs, kept.stop - kept.start), dtype=np.complex128)
    for run in range(runs):
        pair = cross_spectra(x[2 * run : 2 * run + 2], rate=RATE, segment=128)
        averages[run] = pair.matrix[0, 1, kept]
    power = np.mean(np.abs(averages) ** 2)
    assert segment_averages(SEGMENT, 21)[0] == pytest.approx(11.18, abs=0.01)
    # E|G_xy|² = G_xx G_yy / n_d for independent signals; G_xx = 2/rate for unit white noise.
    worth, correlation = segment_averages(128, 21)
    assert (2.0 / RATE) ** 2 / power == pytest.approx(worth, rel=0.03)
    for lag, expected in enumerate(correlation):
        products = averages[:, lag:] * np.conj(averages[:, : averages.shape[1] - lag])
        assert np.mean(products).real / power == pytest.approx(expected, abs=0.02)
