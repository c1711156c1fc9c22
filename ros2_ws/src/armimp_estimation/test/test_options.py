"""Options, records and trials that make no sense are refused with one line that says why."""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.arm_models import require_model
from armimp_estimation.estimators.registry import make_estimators
from armimp_estimation.estimators.welch import WelchSiso, invert
from armimp_estimation.frf import frf_matrix, order_trials
from armimp_estimation.mbk import MBK
from armimp_estimation.torque_timing import TorqueReading
from armimp_estimation.trial import TrialData
from support.synthetic_trials import LOOP, SEGMENT, made_record, synthetic_trials, with_readings

NAN, INFINITE = float("nan"), float("inf")
EYE = np.eye(2)

of_matrices = functools.partial(MBK, M=EYE, K=EYE)


@pytest.mark.parametrize(
    ("make", "message", "wrong"),
    [
        (of_matrices, r"B has shape \(3, 3\), expected \(2, 2\)", {"B": np.eye(3)}),
        (of_matrices, "finite", {"B": np.full((2, 2), NAN)}),
        (require_model, r"'spring'.*reflex", {"name": "spring"}),
        (make_estimators, r"unknown estimator 'welsh'.*welch_siso", {"estimators": ["welsh"]}),
        *(
            (TorqueReading, f"TorqueReading\n{next(iter(wrong))}", wrong)
            for wrong in (
                {"delay": -1.5},
                {"cutoff": INFINITE},
                {"order": 0},
                {"actuator_lag": -1e-3},
                {"uncertainty": -0.1},
                {"uncertainty": NAN},
            )
        ),
    ],
)
def test_when_an_option_makes_no_sense_expect_it_in_the_error(
    make: Callable[..., object], message: str, wrong: dict[str, object]
) -> None:
    with pytest.raises((ConfigurationError, ValueError), match=message):
        make(**wrong)


# --- Trials that do not belong together, and spectra that tell nothing, are refused -------------


def test_when_the_record_is_too_short_expect_its_trial_in_the_error() -> None:
    with pytest.raises(DataError, match="trial 2: record of 1000 samples is shorter than one"):
        TrialData.of(made_record(np.zeros((2, 1000)), trial=2))


def test_when_a_joint_has_two_trials_expect_data_error() -> None:
    data = synthetic_trials()
    with pytest.raises(DataError, match=r"2 trials perturb joint 1 \(joint_1\).*: trials 1, 1"):
        order_trials([*data, data[0]])
    stored = [
        dataclasses.replace(data[0], record=dataclasses.replace(data[0].record, bag=bag))
        for bag in ("a/1", "b/1")
    ]
    with pytest.raises(DataError, match="trials 1 of a/1, 1 of b/1"):
        order_trials([*stored, data[1]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint_names": ("x", "y")}, "trial 2 has joints x, y, trial 1 has joint_1, joint_2"),
        ({"rate": 250.0}, "250.0 samples per second, trial 1 has 125.0"),
        ({"perturbation": np.eye(2, 6144)}, "trial 2 perturbs joint_1 as well as joint_2"),
    ],
)
def test_when_trials_do_not_belong_together_expect_data_error(
    change: dict[str, object], message: str
) -> None:
    first, second = synthetic_trials()
    with pytest.raises(DataError, match=message):
        order_trials([first, with_readings(second, **change)])


def test_a_perturbation_that_leaks_into_the_channel_of_another_joint_is_none_of_that() -> None:
    first, second = synthetic_trials()
    shares = np.array([[0.02], [1.0]])
    leaking = with_readings(second, perturbation=shares * second.record.perturbation[1])
    assert order_trials([first, leaking]) == (first, leaking)


def test_when_there_is_one_segment_only_expect_data_error() -> None:
    loop = dataclasses.replace(LOOP, samples=1100)
    with pytest.raises(DataError, match="joint 1: 1 segment gives no measure of noise"):
        WelchSiso().estimate(synthetic_trials(loop))


def test_when_there_is_no_perturbation_expect_data_error() -> None:
    record = made_record(np.random.default_rng(0).standard_normal((2, 6144)), rate=125.0)
    with pytest.raises(DataError, match="joint 1: no perturbation at"):
        frf_matrix([TrialData.of(record, segment=SEGMENT)])


def test_when_motions_are_dependent_expect_the_frequency_in_the_error() -> None:
    matrix = np.repeat(np.eye(2, dtype=np.complex128)[:, :, None], 3, axis=2)
    matrix[:, :, 1] = 1.0
    with pytest.raises(DataError, match=r"linearly dependent at 2.5 Hz"):
        invert(matrix, np.array([2.0, 2.5, 3.0]))
