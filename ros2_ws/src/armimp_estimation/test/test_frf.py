"""Trials that do not belong together, and spectra that tell nothing, are refused."""

import dataclasses

import numpy as np
import pytest

from armimp_common.errors import DataError
from armimp_estimation.estimators.welch import WelchSiso, invert
from armimp_estimation.frf import frf_matrix, order_trials
from armimp_estimation.trial import TrialData
from support.synthetic_trials import (
    LOOP,
    WELCH,
    made_record,
    synthetic_trials,
)


def test_when_a_joint_has_two_trials_expect_data_error() -> None:
    data = synthetic_trials()
    with pytest.raises(DataError, match=r"2 trials perturb joint 1 \(joint_1\).*: trials 1, 1"):
        order_trials([*data, data[0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint_names": ("x", "y")}, "trial 2 has joints x, y, trial 1 has joint_1, joint_2"),
        ({"rate": 250.0}, "250.0 samples per second, trial 1 has 125.0"),
        ({"perturbation": np.ones((2, 6144))}, "trial 2 perturbs joint_1 as well as joint_2"),
    ],
)
def test_when_trials_do_not_belong_together_expect_data_error(
    change: dict[str, object], message: str
) -> None:
    first, second = synthetic_trials()
    record = dataclasses.replace(second.record, **change)  # type: ignore[arg-type]
    with pytest.raises(DataError, match=message):
        order_trials([first, dataclasses.replace(second, record=record)])


def test_when_there_is_one_segment_only_expect_data_error() -> None:
    loop = dataclasses.replace(LOOP, samples=1100)
    with pytest.raises(DataError, match="joint 1: 1 segment gives no measure of noise"):
        WelchSiso().estimate(synthetic_trials(loop))


def test_when_there_is_no_perturbation_expect_data_error() -> None:
    record = made_record(np.random.default_rng(0).standard_normal((2, 6144)), rate=125.0)
    with pytest.raises(DataError, match="joint 1: no perturbation at"):
        frf_matrix([TrialData.of(record, welch=WELCH)])


def test_when_motions_are_dependent_expect_the_frequency_in_the_error() -> None:
    matrix = np.repeat(np.eye(2, dtype=np.complex128)[:, :, None], 3, axis=2)
    matrix[:, :, 1] = 1.0
    with pytest.raises(DataError, match=r"linearly dependent at 2.5 Hz"):
        invert(matrix, np.array([2.0, 2.5, 3.0]))
