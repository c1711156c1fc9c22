import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common.errors import DataError
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import SpectralAccumulator, WelchConfig
from armimp_estimation.trial import TrialData, channels
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, synthetic_trial

CONFIG = WelchConfig(segment=256, overlap=192)
LOOP = SyntheticConfig(rate=125.0, samples=1000, voluntary=0.1)


def record(joint: int = 1) -> TrialRecord:
    return synthetic_trial(TWO_JOINT_ARM, joint, LOOP, seed=3)


@pytest.mark.parametrize("joint", [0, 1])
def test_channels_are_perturbation_of_the_joint_then_angles_then_torques(joint: int) -> None:
    source = record(joint)
    trial = TrialData.from_record(source, CONFIG).spectra
    angle = trial.position_channel(1)
    torque = trial.torque_channel(0)
    assert (trial.joints, angle, torque) == (2, 2, 3)
    scaled = TrialRecord(
        trial=1,
        perturbed_joint=joint,
        rate=125.0,
        joint_names=source.joint_names,
        perturbation=source.perturbation * 2.0,
        position=source.position * np.array([[1.0], [4.0]]),
        torque=source.torque * np.array([[8.0], [1.0]]),
        start_ns=0,
        seed=None,
    )
    # Powers of two scale without rounding.
    other = TrialData.from_record(scaled, CONFIG).spectra
    np.testing.assert_array_equal(other.input_power, 4.0 * trial.input_power)
    factors = np.array([2.0, 1.0, 4.0, 8.0, 1.0])
    expected = factors[:, None, None] * factors[None, :, None] * trial.spectra.matrix
    np.testing.assert_array_equal(other.spectra.matrix, expected)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, 400), min_size=1, max_size=20))
def test_gathering_live_gives_the_bits_of_the_whole_record(sizes: list[int]) -> None:
    source = record()
    live = SpectralAccumulator(5, source.rate, CONFIG)
    begin = 0
    for size in [*sizes, source.samples]:
        part = slice(begin, begin + size)
        signals = source.perturbation, source.position, source.torque
        live.push(channels(1, *(signal[:, part] for signal in signals)))
        begin += size
    assert live.samples == source.samples
    assert live.segments == 12
    offline = TrialData.from_record(source, CONFIG).spectra
    assert live.result().matrix.tobytes() == offline.spectra.matrix.tobytes()


def test_when_the_record_is_too_short_expect_its_trial_in_the_error() -> None:
    with pytest.raises(DataError, match="trial 2: record of 1000 samples is shorter than one"):
        TrialData.from_record(record())


def test_when_record_and_spectra_are_of_different_joints_expect_data_error() -> None:
    other = TrialData.from_record(record(0), CONFIG).spectra
    with pytest.raises(DataError, match="joint 2 of 2, its spectra of joint 1 of 2"):
        TrialData(record=record(1), spectra=other)
