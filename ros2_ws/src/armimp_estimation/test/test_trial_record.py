import math
from typing import Any

import numpy as np
import pytest

from armimp_common.errors import DataError
from armimp_estimation.record import TrialRecord


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


def test_arrays_of_any_layout_become_contiguous_float64_with_the_same_values() -> None:
    values = np.arange(10, dtype=np.float32).reshape(5, 2).T
    made = record(position=values)
    assert made.position.flags.c_contiguous
    assert made.position.dtype == np.float64
    np.testing.assert_array_equal(made.position, values)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["perturbation", "position", "torque"])
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
