"""Records of trials whose parts do not fit, or hold no numbers, are refused."""

import math
from typing import Any

import numpy as np
import pytest

from armimp_common.errors import DataError
from armimp_estimation.record import TrialRecord
from armimp_estimation.trial import TrialData
from support.synthetic_trials import made_record


def record(**changes: Any) -> TrialRecord:
    names = {"joint_names": ("shoulder", "elbow"), "trial": 2, "perturbed_joint": 1}
    return made_record(np.zeros((2, 5)), **{**names, **changes})


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


def test_when_the_record_is_too_short_expect_its_trial_in_the_error() -> None:
    with pytest.raises(DataError, match="trial 2: record of 1000 samples is shorter than one"):
        TrialData.of(made_record(np.zeros((2, 1000)), trial=2))
