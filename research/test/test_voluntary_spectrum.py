"""The power spectrum of voluntary torque against the stream itself."""

from __future__ import annotations

import numpy as np
import pytest

from armimp_sim.voluntary import VoluntaryParameters, voluntary_torque
from research.limits import power_spectrum

PERIOD = 1e-3
CONFIG = VoluntaryParameters(rms=0.3, cutoff=2.0)


def test_band_power_is_that_of_a_long_stream() -> None:
    samples = 400_000
    torque = voluntary_torque(CONFIG, joints=2, seed=4).take(samples)
    periodogram = np.mean(np.abs(np.fft.rfft(torque, axis=0)) ** 2, axis=1) / samples
    f = np.arange(samples // 2 + 1, dtype=np.float64) / (samples * PERIOD)
    for low, high in ((0.1, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0)):
        band = (f >= low) & (f < high)
        # Chi squared with two degrees of freedom for each bin and joint; 4 standard deviations.
        tolerance = 4.0 / np.sqrt(2.0 * np.count_nonzero(band))
        expected = np.mean(power_spectrum(CONFIG, f[band]))
        assert np.mean(periodogram[band]) == pytest.approx(expected, rel=tolerance)
