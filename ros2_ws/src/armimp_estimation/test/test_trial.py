"""A trial: its record as arrays, and its spectra."""

import math
from typing import Any

import numpy as np
import pytest

from armimp_common.errors import DataError
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialData
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, synthetic_trial

CONFIG = WelchConfig(segment=256, overlap=192)
LOOP = SyntheticConfig(rate=125.0, samples=1000, voluntary=0.1)


def record(**changes: Any) -> TrialRecord:
    values: dict[str, Any] = {
        "trial": 2,
        "perturbed_joint": 1,
        "rate": 1000.0,
        "joint_names": ("shoulder", "elbow"),
        "perturbation": np.zeros((2, 5)),
        "position": np.zeros((2, 5)),
        "torque": np.zeros((2, 5)),
        "start_ns": 7,
        "seed": None,
    }
    return TrialRecord(**(values | changes))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["perturbation", "position", "torque", "command"])
def test_when_a_sample_is_not_finite_expect_its_joint_and_place_in_the_error(
    name: str, bad: float
) -> None:
    values = np.zeros((2, 5))
    values[1, 3] = bad
    with pytest.raises(DataError, match=f"trial 2: {name} of elbow is {bad} at sample 3"):
        record(**{name: values})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position": np.zeros((3, 5))}, r"position has shape \(3, 5\), expected \(2, N\)"),
        ({"torque": np.zeros((2, 4))}, "torque has 4 samples, perturbation has 5"),
        ({"command": np.zeros((2, 4))}, "command has 4 samples, perturbation has 5"),
        ({"perturbation": np.zeros(5)}, r"perturbation has shape \(5,\)"),
        ({"perturbed_joint": 2}, "no joint 3 among 2 joints"),
        ({"perturbed_joint": -1}, "no joint 0"),
        ({"joint_names": ("elbow", "elbow")}, "distinct"),
        ({"joint_names": ()}, "distinct"),
        ({"rate": 0.0}, "rate must be positive, got 0.0"),
        ({"rate": math.nan}, "rate must be positive, got nan"),
    ],
)
def test_when_the_parts_do_not_fit_expect_a_data_error(
    changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(DataError, match=message):
        record(**changes)


def perturbed(joint: int = 1) -> TrialRecord:
    return synthetic_trial(TWO_JOINT_ARM, joint, LOOP, seed=3)


@pytest.mark.parametrize("joint", [0, 1])
def test_channels_are_perturbation_of_the_joint_then_angles_then_torques(joint: int) -> None:
    source = perturbed(joint)
    trial = TrialData.of(source, welch=CONFIG)
    angle = trial.position_channel(1)
    torque = trial.torque_channel(0)
    assert (angle, torque) == (2, 3)
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
    other = TrialData.of(scaled, welch=CONFIG)
    np.testing.assert_array_equal(other.input_power, 4.0 * trial.input_power)
    factors = np.array([2.0, 1.0, 4.0, 8.0, 1.0])
    expected = factors[:, None, None] * factors[None, :, None] * trial.spectra.matrix
    np.testing.assert_array_equal(other.spectra.matrix, expected)


def test_when_the_record_is_too_short_expect_its_trial_in_the_error() -> None:
    with pytest.raises(DataError, match="trial 2: record of 1000 samples is shorter than one"):
        TrialData.of(perturbed())
