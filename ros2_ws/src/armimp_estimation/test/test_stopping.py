"""When trials may end: never too early, at fixed numbers of samples, only for known errors."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import pytest

from armimp_common.status import NOTICE_TICKS, StoppingDecision
from armimp_estimation.estimators.lpm import FittedColumn
from armimp_estimation.fit import fit_mbk
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.record import TrialRecord
from armimp_estimation.recorder import StoppingRule, largest_error
from armimp_estimation.trial import TrialData
from support import known
from support.streams import trial_status
from support.synthetic_trials import (
    LPM,
    SEGMENT,
    TWO_JOINT_ARM,
    SyntheticConfig,
    part_of,
    stacked,
    synthetic_trial,
)

BOUND = 0.02
LEAST = 20_000 - NOTICE_TICKS
PLANNED = trial_status(trial=2, ticks=50_000)
rule = partial(StoppingRule, EstimatorParameters(target_error=BOUND))


def column(error: float) -> FittedColumn:
    values, errors = np.array([[1.0, 2.0]] * 3), np.array([[error, error]] * 3)
    return FittedColumn(joint=1, values=values, errors=errors, preliminary=False)


def decisions(one: StoppingRule, samples: int, error: float) -> list[StoppingDecision]:
    """All decisions while the samples come in tens."""
    told = [one.decide(count, lambda _: column(error)) for count in range(0, samples + 1, 10)]
    return [decision for decision in told if decision is not None]


def test_largest_error_is_relative_and_names_its_element() -> None:
    values = np.array([[1.0, -2.0], [10.0, 1.0], [5.0, -0.5]])
    errors = np.array([[0.01, 0.02], [0.05, 0.01], [0.04, 0.03]])
    found = FittedColumn(joint=0, values=values, errors=errors, preliminary=False)
    assert largest_error(found) == (0.06, "K21")


@pytest.mark.parametrize("values", [0.0, float("nan")])
def test_a_parameter_without_a_relative_error_is_never_good_enough(values: float) -> None:
    spoiled = column(0.001)
    spoiled.values[2, 1] = values
    assert largest_error(spoiled) == (np.inf, "K22")
    spoiled.errors[2, 1] = 0.0
    assert largest_error(spoiled) == (np.inf, "K22")


def test_first_comes_an_announcement_then_decisions_in_their_time() -> None:
    found = decisions(rule(PLANNED), 49_000, 0.05)
    assert (found[0].trial, found[0].samples, found[0].due) == (2, 0, LEAST)
    assert np.isnan(found[0].largest)
    # Two seconds apart, or a tenth of the trial.
    due = [LEAST]
    while due[-1] + max(2000, due[-1] // 10) + NOTICE_TICKS < 50_000:
        due.append(due[-1] + max(2000, due[-1] // 10))
    assert [one.samples for one in found[1:]] == due
    assert [one.due for one in found[:-1]] == due
    assert found[-1].due is None
    assert not any(one.enough for one in found)


def test_a_trial_that_is_good_enough_ends_once_and_not_before_its_least_length() -> None:
    found = decisions(rule(PLANNED), 49_000, 0.001)
    assert [(one.samples, one.enough, one.due) for one in found[1:]] == [(LEAST, True, None)]
    assert (found[1].largest, found[1].element) == (0.001, "M12")


def test_samples_that_come_late_do_not_change_what_is_considered() -> None:
    one = rule(PLANNED)
    one.decide(0, lambda _: None)
    told = one.decide(LEAST + 1234, lambda samples: column(0.001 if samples == LEAST else 1.0))
    decision = known(told)
    assert (decision.samples, decision.largest) == (LEAST, 0.001)


@pytest.mark.parametrize("planned", [1000, 20_000])
def test_a_trial_no_longer_than_the_least_is_announced_and_left_alone(planned: int) -> None:
    (only,) = decisions(rule(trial_status(ticks=planned)), planned, 0.0)
    assert (only.samples, only.due) == (0, None)


def ended(record: TrialRecord, others: Sequence[TrialRecord]) -> TrialRecord:
    """The part of a trial of 100 s that is recorded with a bound of 15 %."""

    def column_of(samples: int) -> FittedColumn:
        return LPM.column(part_of(record, 0, samples), others)

    settings, status = EstimatorParameters(target_error=0.15), trial_status(ticks=record.samples)
    rule = StoppingRule(settings, status, record.rate)
    decision = known(rule.decide(0, lambda _: None))
    while decision.due is not None:
        decision = known(rule.decide(decision.due, column_of))
    return part_of(record, 0, decision.samples + NOTICE_TICKS) if decision.enough else record


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_intervals_of_trials_that_end_early_hold_the_truth_and_estimates_are_not_biased() -> None:
    """With a voluntary torque, which makes lengths differ by chance."""
    loop = SyntheticConfig(rate=200.0, samples=20_000, voluntary=0.3, torque_noise=0.005)
    off, lengths = [], []
    for seed in range(40):
        trials: list[TrialRecord] = []
        for joint in (0, 1):
            trials.append(ended(synthetic_trial(TWO_JOINT_ARM, joint, loop, seed), trials))
        data = [TrialData.of(one, segment=SEGMENT) for one in trials]
        fit = fit_mbk(LPM.estimate(data))
        off.append((stacked(fit.mbk) - stacked(TWO_JOINT_ARM)) / fit.errors)
        lengths += [one.duration for one in trials]
    assert np.percentile(lengths, 90) > 2.0 * np.percentile(lengths, 10)
    assert 0.9 < np.mean(np.abs(off) < 1.96) < 0.985
    # None of the twelve means may be off by 3.5 of its standard errors.
    assert np.max(np.abs(np.mean(off, axis=0))) < 3.5 / np.sqrt(40)
