import dataclasses
import string
from typing import Any

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.fit import Calibration
from armimp_estimation.identify import identify
from armimp_estimation.metadata import Metadata
from armimp_estimation.problems import Concern, Problem, ProblemCode, Severity, kinds
from armimp_estimation.torque_timing import TorqueReading
from armimp_estimation.trial import TrialData
from armimp_estimation.verdict import Verdict, judge_coherence, judge_locking
from support import known
from support.problems import codes, having
from support.synthetic_trials import (
    SEGMENT,
    TWO_JOINT_ARM,
    SyntheticConfig,
    off,
    synthetic_trial,
    synthetic_trials,
    with_readings,
    worst_errors,
)

EXACT = Metadata(calibration=Calibration())
KNOWN = Metadata(calibration=Calibration(), truth=TWO_JOINT_ARM)
LOOP = SyntheticConfig(rate=125.0, samples=6144, torque_noise=0.02)
ESTIMATORS = ("welch_siso", "welch_full")
UNKNOWN = TorqueReading()


def test_a_good_experiment_is_valid_and_close_to_the_truth() -> None:
    result = identify(synthetic_trials(LOOP), ESTIMATORS, KNOWN)
    assert result.valid
    assert result.problems == ()
    assert list(result.estimators) == list(ESTIMATORS)
    for one in result.estimators.values():
        assert (known(one.vaf) > 99.9).all()
        assert (one.fit.r2 > 0.999).all()
        assert np.min(one.coherence.motion.mean(axis=-1)) > one.coherence_limit > 0.0
        assert (one.coherence.derived.mean(axis=-1) > 0.97).all()
        errors = worst_errors(one.fit.mbk, TWO_JOINT_ARM)
        assert errors["M"] < 0.01
        assert errors["B"] < 0.05
        assert errors["K"] < 0.03
    assert [trial.k for trial in result.trials] == [1, 2]
    assert result.trials[1].lock_ratio[1] == 1.0
    assert result.trials[1].lock_ratio[0] < 1e-6


def test_when_nobody_declares_a_gain_and_no_command_confirms_it_expect_it_in_the_errors() -> None:
    result = identify(synthetic_trials(LOOP), ("welch_full",))
    assert result.valid
    noted = having(result.problems, ProblemCode.GAIN_UNCONFIRMED)
    assert [one.values["doubt"] for one in noted] == [10.0, 10.0]
    fit = result.estimators["welch_full"].fit
    assert (fit.errors[2] > 0.1 * np.abs(fit.mbk.K)).all()


@pytest.mark.parametrize("periods", [(1024, 768), (1024, 6144), (512, 768)])
def test_trials_may_be_perturbed_with_different_periods_or_none(periods: tuple[int, int]) -> None:
    repeated = []
    for joint, period in enumerate(periods):
        loop = dataclasses.replace(LOOP, samples=period, torque_noise=1e-4)
        one = synthetic_trial(TWO_JOINT_ARM, joint, loop, 1)
        streams: dict[str, Any] = {
            name: np.tile(getattr(one, name), 6144 // period)
            for name in ("position", "torque", "perturbation")
        }
        repeated.append(TrialData.of(dataclasses.replace(one, **streams), segment=SEGMENT))
    result = identify(repeated, ("lpm_full",), KNOWN)
    assert result.valid, result.problems
    assert max(worst_errors(result.estimators["lpm_full"].fit.mbk, TWO_JOINT_ARM).values()) < 0.01


@pytest.mark.parametrize("stream", ["position", "torque", "perturbation", "command"])
@pytest.mark.parametrize(("value", "said"), [(3e200, r"3e\+200"), (np.nan, "nan")])
def test_when_values_cannot_be_multiplied_expect_the_largest_in_the_error(
    stream: str, value: float, said: str
) -> None:
    record = synthetic_trial(TWO_JOINT_ARM, 0, LOOP, 1)
    record = dataclasses.replace(record, command=record.torque.copy())
    getattr(record, stream)[0, 5] = value
    with pytest.raises(DataError, match=rf"trial .*: {said} is no angle and no torque"):
        TrialData.of(record, segment=SEGMENT)


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (0.5, 5.0),
        pytest.param(2.0, 30.0, marks=pytest.mark.slow),
        pytest.param(5.0, 15.0, marks=pytest.mark.slow),
    ],
)
def test_without_power_in_a_part_of_the_band_the_rest_is_estimated_with_a_note(
    low: float, high: float
) -> None:
    loop = dataclasses.replace(LOOP, lowest=low, bandwidth=high)
    result = identify(synthetic_trials(loop), ("lpm_full", "welch_full"), KNOWN)
    assert result.valid
    (note,) = having(result.problems, ProblemCode.BAND_NARROWED)
    assert note.values["low"] == pytest.approx(low, abs=0.4)
    assert result.estimators["lpm_full"].estimate.f[0] == pytest.approx(low, abs=0.1)
    assert all(off(one.fit).max() < 3.5 for one in result.estimators.values())


def test_a_stiff_arm_that_is_perturbed_slowly_gets_no_implausible_inertia() -> None:
    arm = dataclasses.replace(TWO_JOINT_ARM, K=150.0 * TWO_JOINT_ARM.K)
    loop = dataclasses.replace(LOOP, bandwidth=0.5, torque_noise=0.001)
    result = identify(synthetic_trials(loop, arm=arm), ("lpm_full",), EXACT)
    assert ProblemCode.BAND_NARROWED in codes(result.problems)
    assert ProblemCode.IMPLAUSIBLE_VALUE not in codes(result.problems)


def test_an_inertia_that_is_not_symmetric_is_refused() -> None:
    across = TWO_JOINT_ARM.M * [[1.0, 1.5], [1.0, 1.0]]
    arm = dataclasses.replace(TWO_JOINT_ARM, M=across)
    result = identify(synthetic_trials(LOOP, arm=arm), ("welch_full",), EXACT)
    assert not result.verdict.impedance
    (uneven,) = having(result.problems, ProblemCode.UNEVEN_INERTIA)
    assert uneven.values["value"] == pytest.approx(across[0, 1], rel=0.02)
    assert uneven.values["other"] == pytest.approx(across[1, 0], rel=0.02)


@pytest.mark.parametrize(("apart", "valid"), [(0.0, False), (0.3, True)])
def test_inertia_may_differ_between_trials_that_have_other_postures(
    apart: float, valid: bool
) -> None:
    # Locked joints give way, so that each trial shows its own inertia of both joints.
    loop = dataclasses.replace(LOOP, lock_stiffness=100.0)
    bent = dataclasses.replace(TWO_JOINT_ARM, M=TWO_JOINT_ARM.M * [[1.1, 1.2], [1.2, 1.0]])
    first = synthetic_trials(loop)[0]
    record = synthetic_trial(bent, 1, loop, 1)
    position = record.position + np.array([[apart], [0.0]])
    second = TrialData.of(dataclasses.replace(record, position=position), segment=SEGMENT)
    result = identify([first, second], ("lpm_full",), EXACT)
    assert result.valid is valid
    fit = result.estimators["lpm_full"].fit
    inertia = np.stack((TWO_JOINT_ARM.M[:, 0], bent.M[:, 1]), axis=1)
    if valid:
        assert (np.abs(fit.mbk.M - [inertia, TWO_JOINT_ARM.M]) < 3.5 * fit.errors[0]).all()
        assert (fit.errors[0] < 0.3 * inertia).all()


@pytest.mark.parametrize(
    ("mixed", "share", "valid"),
    [("position", -0.2, False), ("position", -0.1, True), ("torque", 0.2, True)],
)
def test_cross_talk_from_another_joint_is_refused_or_in_the_errors(
    mixed: str, share: float, valid: bool
) -> None:
    # The sign is the one that makes this arm look less symmetric than it is.
    mixing = np.array([[1.0, share], [0.0, 1.0]])
    data = [
        with_readings(trial, reading=UNKNOWN, **{mixed: mixing @ getattr(trial.record, mixed)})
        for trial in synthetic_trials(LOOP)
    ]
    result = identify(data, ("lpm_full",))
    assert result.verdict.impedance is valid
    assert off(result.estimators["lpm_full"].fit).max() < 2.0


def test_angles_and_torques_in_another_order_than_perturbations_are_refused() -> None:
    loop = dataclasses.replace(LOOP, lock_stiffness=3000.0)
    records = [trial.record for trial in synthetic_trials(loop)]
    swapped = [
        dataclasses.replace(one, position=one.position[::-1], torque=one.torque[::-1])
        for one in records
    ]
    data = [TrialData.of(one, segment=SEGMENT) for one in swapped]
    result = identify(data, ("welch_full",), EXACT)
    (permuted,) = having(result.problems, ProblemCode.SENSORS_PERMUTED)
    assert permuted.values == {"perturbed": "joint_1, joint_2", "moving": "joint_2, joint_1"}
    assert not result.verdict.impedance


def test_when_axes_of_trials_and_joints_are_exchanged_expect_channels_of_other_trials() -> None:
    trials = synthetic_trials()
    kinds, records = ("position", "torque"), [trial.record for trial in trials]
    mixed = [
        {kind: np.stack([getattr(one, kind)[k] for one in records]) for kind in kinds}
        for k in (0, 1)
    ]
    exchanged = [with_readings(trial, **one) for trial, one in zip(trials, mixed, strict=True)]
    result = identify(exchanged, ("lpm_full",), EXACT)
    found = having(result.problems, ProblemCode.TRIALS_MIXED)
    assert [(one.trial, one.values["name"]) for one in found] == [(1, "joint_2"), (2, "joint_1")]
    assert not result.verdict.impedance
    sound = identify(trials, ("lpm_full",), EXACT)
    assert ProblemCode.TRIALS_MIXED not in codes(sound.problems)


def test_when_locking_fails_expect_it_in_the_verdict_though_derived_coherence_is_high() -> None:
    loose = synthetic_trials(dataclasses.replace(LOOP, lock_stiffness=100.0))
    result = identify(loose, ("welch_siso", "lpm_full"), KNOWN)
    of_siso = codes(one for one in result.problems if one.estimator == "welch_siso")
    assert {ProblemCode.LOCK_RATIO, ProblemCode.LOCK_BIAS} <= set(of_siso)
    assert not Verdict.of(result.problems, "welch_siso").impedance
    siso, full = (result.estimators[name] for name in ("welch_siso", "lpm_full"))
    assert (siso.coherence.derived.mean(axis=-1) > 0.9).all()
    assert known(siso.vaf).min() < 0.0
    # Inversion of the whole matrix undoes motion of all joints.
    assert known(full.vaf).min() > 99.0
    assert Verdict.of(result.problems, "lpm_full").impedance
    assert result.deciding == ("lpm_full",)
    said = "\n".join(map(str, result.problems))
    for locked, moved in (("joint_2", "joint_1"), ("joint_1", "joint_2")):
        assert f"{locked} was not held still while {moved} was perturbed: within the band" in said
    assert "element (1, 2) may be biased" in said


@pytest.mark.parametrize("estimators", [[], ["welch_siso", "welch_siso"], ["nonsense"]])
def test_when_estimators_are_not_distinct_known_names_expect_configuration_error(
    estimators: list[str],
) -> None:
    with pytest.raises(ConfigurationError, match="estimator"):
        identify(synthetic_trials(LOOP), estimators, EXACT)


def test_scores_that_are_not_numbers_fail_the_verdict() -> None:
    names = ("a", "b")
    nan = np.full((2, 2), np.nan)
    # Two locked joints, and four elements whose bias is unknown.
    assert len([*judge_locking(names, nan, nan)]) == 6
    assert len([*judge_coherence(names, nan[0], nan, 0.25)]) == 4


def test_a_single_bad_score_is_told_of_the_right_element() -> None:
    names = ("a", "b")
    lock, bound, torque = (np.full((2, 2), value) for value in (0.0, 0.0, 1.0))
    lock[1, 0] = bound[1, 0] = 0.5
    torque[1, 1] = 0.1
    locking = judge_locking(names, lock, bound)
    assert [(one.code, one.values["name"], one.values["perturbed"]) for one in locking] == [
        (ProblemCode.LOCK_RATIO, "b", "a"),
        (ProblemCode.LOCK_BIAS, "b", "a"),
    ]
    (problem,) = judge_coherence(names, np.ones(2), torque, 0.25)
    assert (problem.values["stream"], problem.values["name"]) == ("torque", "b")


def test_each_code_has_one_sentence_that_its_values_fill_and_advice() -> None:
    assert sorted(kinds()) == sorted(ProblemCode)
    for code, kind in kinds().items():
        assert kind.advice
        text = kind.sentences[code]
        fields = {name: spec for _, name, spec, _ in string.Formatter().parse(text) if name}
        values = {name: 3 if spec == "d" else 1.5 if spec else "x" for name, spec in fields.items()}
        sentence = Problem(code=code, trial=2, values=values).sentence
        assert sentence.startswith("trial 2: ")
        assert "{" not in sentence
        assert "\n" not in sentence


FIT = Problem(code=ProblemCode.LACK_OF_FIT, concern=Concern.PARAMETERS, estimator="lpm_full")
STUCK = Problem(code=ProblemCode.STUCK)
NOTE = Problem(code=ProblemCode.DELAY_CORRECTED, severity=Severity.NOTE)


@pytest.mark.parametrize(
    ("problem", "estimators", "impedance", "parameters"),
    [
        (FIT, ["lpm_full"], True, False),
        (FIT, ["welch_siso"], True, True),
        (STUCK, ["any"], False, False),
        (NOTE, ["any"], True, True),
        (NOTE, [], False, False),
    ],
)
def test_a_problem_spoils_what_it_concerns_and_a_note_nothing(
    problem: Problem, estimators: list[str], impedance: bool, parameters: bool
) -> None:
    verdict = Verdict(impedance=impedance, parameters=parameters)
    assert Verdict.of([problem], *estimators) == verdict
