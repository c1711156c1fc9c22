"""Drift of a trial's signals is found beside the response to the perturbation, and removed."""

from dataclasses import replace

import numpy as np
import pytest

from armimp_common.arrays import FloatArray
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.estimators.welch import WelchFull
from armimp_estimation.fit import fit_mbk
from armimp_estimation.record import TrialRecord
from armimp_estimation.trial import SIGNIFICANT, TrialData, slopes_of
from support.synthetic_trials import LOOP, LPM, SEGMENT, SyntheticConfig, synthetic_trial
from support.synthetic_trials import TWO_JOINT_ARM as ARM

SLOPE = np.array([0.02, -0.01])  # N·m/s


def record(joint: int, seed: int = 1, voluntary: float = 0.05) -> TrialRecord:
    return synthetic_trial(ARM, joint, replace(LOOP, voluntary=voluntary), seed)


def drifting(one: TrialRecord, slope: FloatArray = SLOPE) -> TrialRecord:
    t = np.arange(one.samples) / one.rate
    return replace(one, torque=one.torque + 0.7 + slope[:, None] * t)


def test_the_slope_of_a_ramp_is_found_to_within_its_standard_error() -> None:
    ratios = []
    for seed in range(40):
        one = drifting(record(seed % 2, seed, voluntary=0.3))
        slopes, errors = slopes_of(one)
        ratios.append((slopes - np.concatenate((np.zeros(2), SLOPE))) / errors)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.35)


def test_drift_goes_and_offset_stays_and_nothing_else_changes() -> None:
    one = record(0)
    assert TrialData.of(one, segment=SEGMENT).record is one, "without drift"
    data = TrialData.of(drifting(one), segment=SEGMENT)
    found, _ = slopes_of(drifting(one))
    left = data.record.torque - one.torque
    t = (np.arange(one.samples) - 0.5 * (one.samples - 1)) / one.rate
    rest = (SLOPE - found[2:])[:, None] * t
    assert np.max(np.abs(rest)) < 0.1 * np.max(np.abs(SLOPE)) * t[-1]
    middle = 0.7 + SLOPE * 0.5 * (one.samples - 1) / one.rate
    assert left == pytest.approx(middle[:, None] + rest, abs=1e-12)
    assert np.array_equal(data.record.position, one.position)
    assert np.array_equal(data.record.perturbation, one.perturbation)


@pytest.mark.parametrize(
    "estimator",
    [pytest.param(LPM, marks=pytest.mark.slow), WelchFull()],
    ids=lambda one: one.name,
)
def test_drift_costs_the_estimates_nothing_and_would_cost_them_the_stiffness(
    estimator: Estimator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def worst(slope: float) -> tuple[float, float]:
        """Largest error of K, and of the curve at the lowest bins, relative to |Z|."""
        data = [
            TrialData.of(drifting(record(joint), slope * SLOPE), segment=SEGMENT)
            for joint in range(2)
        ]
        found = estimator.estimate(data)
        low = found.f < 0.3
        true = ARM.impedance(found.f)
        curve = np.abs(found.Z / true - 1.0)[:, :, low]
        return float(np.max(np.abs(fit_mbk(found).mbk.K / ARM.K - 1.0))), float(np.max(curve))

    plain, freed = worst(0.0), worst(20.0)
    monkeypatch.setattr("armimp_estimation.trial.SIGNIFICANT", np.inf)
    spoilt = worst(20.0)
    assert freed[0] < plain[0] + 0.01
    assert freed[1] < plain[1] + 0.03
    assert spoilt[1] > 3.0 * freed[1]


def test_the_resonance_of_the_arm_in_a_short_record_is_not_taken_for_drift() -> None:
    # Nothing but the arm: there is no noise in which its curves could hide.
    for seconds in (8, 10, 20, 50):
        config = SyntheticConfig(samples=1000 * seconds)
        for joint in range(2):
            slopes, errors = slopes_of(synthetic_trial(ARM, joint, config, seed=1))
            assert (np.abs(slopes) <= SIGNIFICANT * errors).all(), (seconds, joint)
