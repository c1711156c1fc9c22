"""All joints perturbed at once: the estimate, and the check that inputs are independent."""

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import DataError
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from research.mimo import MimoEstimate, estimate_mimo
from support.synthetic_trials import (
    TWO_JOINT_ARM,
    WELCH,
    made_record,
    relative_error,
    share_within,
)

pytestmark = pytest.mark.slow

FloatArray = NDArray[np.float64]
RATE, SAMPLES = 125.0, 6144
CONTROL = MBK(M=0.2 * np.eye(2), B=4.0 * np.eye(2), K=30.0 * np.eye(2))


def loop_record(
    seed: int, *, push: float = 0.0, noise: float = 0.0, inputs: FloatArray | None = None
) -> TrialRecord:
    """One period of the loop ``(Y + Z) θ = x - d``, ``τ = Z θ + d`` with both joints compliant."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((2, SAMPLES)) if inputs is None else inputs
    d = push * rng.standard_normal((2, SAMPLES))
    f = np.asarray(np.fft.rfftfreq(SAMPLES, 1.0 / RATE), dtype=np.float64)
    arm, control = (np.moveaxis(m.impedance(f), 2, 0) for m in (TWO_JOINT_ARM, CONTROL))
    push_spectrum = np.fft.rfft(d).T
    motion = np.linalg.solve(arm + control, (np.fft.rfft(x).T - push_spectrum)[:, :, None])
    torque = (arm @ motion)[:, :, 0] + push_spectrum
    position = np.fft.irfft(motion[:, :, 0].T, SAMPLES, axis=1)
    readings = np.fft.irfft(torque.T, SAMPLES, axis=1) + noise * rng.standard_normal((2, SAMPLES))
    return made_record(position, readings, x, rate=RATE)


def estimate(*records: TrialRecord) -> MimoEstimate:
    return estimate_mimo(records, WELCH)


def test_when_the_subject_pushes_expect_no_bias_and_variance_that_is_right() -> None:
    true = TWO_JOINT_ARM.impedance(WELCH.frequencies(RATE))
    found = [estimate(loop_record(s, push=0.2, noise=0.1)).impedance for s in range(150)]
    errors = np.array([one.Z - true for one in found])
    squares = np.mean(np.abs(errors) ** 2, axis=0)
    bias = np.abs(np.mean(errors, axis=0)) / np.sqrt(squares)
    assert (np.mean(bias, axis=2) < 0.12).all()  # 0.07 for the mean of 150
    ratio = np.mean(np.mean([one.variance for one in found], axis=0) / squares, axis=2)
    assert (np.abs(ratio - 1.0) < 0.12).all()
    assert 0.935 < share_within(found, true, 0.95) < 0.97


def test_when_inputs_have_much_in_common_expect_data_error() -> None:
    x = np.random.default_rng(4).standard_normal((2, SAMPLES))
    coupled = loop_record(1, inputs=np.stack((x[0], x[0] + 0.1 * x[1])))
    with pytest.raises(DataError, match=r"not independent: condition number .* \(limit 100\)"):
        estimate(coupled)
    found = estimate_mimo([coupled], WELCH, largest_condition=1e5)
    assert np.min(found.coupling.inflation) > 20.0
    assert relative_error(found.impedance, TWO_JOINT_ARM) < 0.1
