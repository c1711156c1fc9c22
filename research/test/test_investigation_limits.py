"""`make research ARGS=limits`: its ratios, its bounds, and estimators against them."""

from __future__ import annotations

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_sim.voluntary import VoluntaryParameters, voluntary_torque
from research.limits import LimitsPlan, power_spectrum, run_limits
from research.limits_statistics import Cell

BASE = ExperimentConfig(arm_sim={"substeps": 20})
PLAN = LimitsPlan(
    base=BASE, levels=((3, 3, 3),), seeds="0:24", estimators=("lpm_full", "welch_siso")
)
Cells = dict[tuple[str, float], Cell]


@pytest.fixture(scope="module")
def cells() -> Cells:
    return {(cell.estimator, cell.voluntary): cell for cell in run_limits(PLAN, workers=2)}


@pytest.mark.slow
def test_no_estimator_has_a_spread_below_the_bound_by_more_than_chance(cells: Cells) -> None:
    """24 runs, 48 ratios: below 0.5 by chance is beyond one in 10⁵ for each."""
    for cell in cells.values():
        assert (cell.spread_ratio > 0.5).all()
        assert float(np.sqrt(np.mean(cell.spread_ratio**2))) > 1.0


@pytest.mark.slow
def test_local_polynomials_come_close_to_the_bound_with_voluntary_torque(cells: Cells) -> None:
    assert float(np.sqrt(np.mean(cells["lpm_full", 0.3].ratio ** 2))) < 1.5
    assert cells["lpm_full", 0.3].worst[1] < 2.0


# --- The power spectrum of voluntary torque -----------------------------------------------------


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
