"""Voluntary torque: strength, spectrum, and independence of the way it is drawn."""

import numpy as np
import pytest
from scipy import signal

from armimp_common.topics import PERIOD
from armimp_sim.model.sensors import ReadingParameters, SensorParameters
from armimp_sim.voluntary import Noise, VoluntaryParameters, reading_noise, voluntary_torque


def _stream(cutoff: float = 20.0) -> Noise:
    return voluntary_torque(VoluntaryParameters(rms=0.5, cutoff=cutoff), joints=2, seed=1)


@pytest.mark.parametrize(("cutoff", "tolerance"), [(2.0, 0.10), (20.0, 0.03), (300.0, 0.02)])
def test_rms_of_a_long_stream_is_the_configured_one(cutoff: float, tolerance: float) -> None:
    torque = _stream(cutoff).take(200_000)
    assert np.sqrt(np.mean(torque**2, axis=0)) == pytest.approx([0.5, 0.5], rel=tolerance)
    assert np.mean(torque, axis=0) == pytest.approx([0.0, 0.0], abs=0.05)


def test_spectrum_is_that_of_second_order_low_pass_noise() -> None:
    torque = _stream().take(400_000)[:, 0]
    f, density = signal.welch(torque, fs=1.0 / PERIOD, nperseg=2048)
    smooth = np.array(
        [np.mean(density[(f > low) & (f < high)]) for low, high in ((1, 5), (19, 21), (58, 62))]
    )
    # |H|² = 1/(1 + (f/fc)⁴): full in the pass band, half at the edge, 1/82 at three times the edge.
    assert smooth[1] / smooth[0] == pytest.approx(0.5, rel=0.1)
    assert smooth[2] / smooth[0] == pytest.approx(1.0 / 82.0, rel=0.2)


@pytest.mark.parametrize("cuts", [[1] * 50, [4096, 4096], [4095, 1, 1, 5000], [9097, 0, 3]])
def test_stream_does_not_depend_on_how_it_is_cut(cuts: list[int]) -> None:
    whole = _stream().take(sum(cuts))
    stream = _stream()
    parts = [stream.take(ticks) for ticks in cuts]
    assert [len(part) for part in parts] == cuts
    assert np.array_equal(np.concatenate(parts), whole)


def test_tremor_fills_its_band_beside_the_voluntary_torque() -> None:
    config = VoluntaryParameters(rms=0.3, cutoff=2.0, tremor=0.1)
    both = voluntary_torque(config, joints=2, seed=3).take(300_000)
    alone = voluntary_torque(config.model_copy(update={"tremor": 0.0}), joints=2, seed=3).take(
        300_000
    )
    tremor = both - alone
    assert np.sqrt(np.mean(tremor**2, axis=0)) == pytest.approx([0.1, 0.1], rel=0.03)
    f, density = signal.welch(tremor[:, 0], fs=1.0 / PERIOD, nperseg=4096)
    assert density[(f > 8.5) & (f < 11.5)].mean() > 30.0 * density[(f < 4.0) | (f > 24.0)].max()


def test_noise_of_readings_is_white_and_does_not_depend_on_how_it_is_cut() -> None:
    sensors = SensorParameters(
        position=ReadingParameters(noise=1e-4), torque=ReadingParameters(noise=0.01)
    )
    whole = reading_noise(sensors, joints=2, seed=3).take(50_000)
    stream = reading_noise(sensors, joints=2, seed=3)
    assert np.array_equal(np.concatenate([stream.take(4097), stream.take(903)]), whole[:5000])
    for kind, rms in enumerate((1e-4, 0.01)):
        assert whole[:, kind].std(axis=0) == pytest.approx([rms, rms], rel=0.02)
    neighbours = np.corrcoef(whole[1:, 1, 0], whole[:-1, 1, 0])[0, 1]
    assert abs(neighbours) < 0.02
