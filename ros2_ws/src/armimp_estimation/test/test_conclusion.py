"""Conclusions: one path for live and recorded trials, and whatever is wrong in words."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armimp_common.errors import DataError
from armimp_common.topics import DATA_STREAMS, TRIAL
from armimp_estimation.bags import read_bag
from armimp_estimation.bags.statuses import decode_trial_status
from armimp_estimation.conclusion import Conclusion, FinishedTrial, conclude, reading_of, truth_of
from armimp_estimation.recording import Recording
from armimp_estimation.results import Summary, read_frf, read_summary
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from support.recordings import recorded_arm
from support.synthetic_bags import Message
from support.synthetic_trials import TWO_JOINT_ARM

RECORDING = recorded_arm()
NAMES = RECORDING.records[0].joint_names
ESTIMATORS = ("welch_siso", "welch_full")
METADATA = {
    "config": json.dumps({"friction": 0}),
    "seed": "5",
    "joint_names": json.dumps(NAMES),
    "truth": json.dumps(
        {
            "M": TWO_JOINT_ARM.M.tolist(),
            "B": TWO_JOINT_ARM.B.tolist(),
            "K": TWO_JOINT_ARM.K.tolist(),
        }
    ),
}


def record(
    directory: Path | None, messages: Sequence[Message] = RECORDING.messages
) -> list[FinishedTrial]:
    trials: list[FinishedTrial] = []

    def keep(trial: FinishedTrial | None, problem: str) -> None:
        assert trial is not None, problem
        trials.append(trial)

    recording = Recording(NAMES, directory, METADATA, keep)
    for topic, _, raw in messages:
        if topic == TRIAL:
            recording.add_status(decode_trial_status(raw))
        else:
            recording.add(topic, raw)
    recording.stop()
    return trials


LIVE = record(None)


def conclusion_of(
    trials: Sequence[FinishedTrial] = LIVE,
    metadata: dict[str, str] | None = None,
    problems: Sequence[str] = (),
) -> Conclusion:
    return conclude(
        trials,
        metadata=METADATA if metadata is None else metadata,
        joint_names=("shoulder", "elbow"),
        estimators=ESTIMATORS,
        problems=problems,
    )


def comparable(summary: Summary) -> str:
    """All of a summary but the speed of the run, which a bag does not tell."""
    return summary.model_copy(
        update={"trials": [trial.model_copy(update={"rtf": 0.0}) for trial in summary.trials]}
    ).model_dump_json()


def test_complete_trials_give_a_valid_result_near_the_truth() -> None:
    summary = conclusion_of().summary

    assert (summary.valid, summary.problems) == (True, [])
    assert (summary.joints, summary.seed, summary.config) == (2, 5, {"friction": 0})
    assert [(trial.k, trial.ticks, trial.lost) for trial in summary.trials] == [
        (1, 10_000, 0),
        (2, 10_000, 0),
    ]
    assert set(summary.estimators) == set(ESTIMATORS)
    for result in summary.estimators.values():
        # Short trials: the averaged spectra leak.
        np.testing.assert_allclose(result.M, TWO_JOINT_ARM.M, rtol=0.05)
        assert result.vaf is not None
        assert np.min(result.vaf) > 98.0


def test_live_trials_and_those_read_from_bags_give_equal_summaries_and_curves(
    tmp_path: Path,
) -> None:
    live = record(tmp_path)
    contents = [read_bag(path) for path in sorted((tmp_path / "bags").iterdir())]
    read = [
        FinishedTrial(assembled=content.trials[0], bag=trial.bag)
        for content, trial in zip(contents, live, strict=True)
    ]

    one = conclusion_of(live)
    other = conclusion_of(read, dict(contents[0].metadata))

    assert comparable(one.summary) == comparable(other.summary)
    assert all(math.isnan(trial.rtf) for trial in other.summary.trials)
    assert one.identification is not None
    assert other.identification is not None
    for name, result in one.identification.estimators.items():
        twin = other.identification.estimators[name].estimate
        np.testing.assert_array_equal(result.estimate.Z, twin.Z)
        np.testing.assert_array_equal(result.estimate.variance, twin.variance)


def test_order_of_the_trials_does_not_matter() -> None:
    assert comparable(conclusion_of(LIVE[::-1]).summary) == comparable(conclusion_of().summary)


@pytest.mark.parametrize("missing", [0, 1])
def test_when_a_trial_is_missing_expect_an_invalid_result_which_names_the_joint(
    missing: int,
) -> None:
    conclusion = conclusion_of([LIVE[1 - missing]])

    summary = conclusion.summary
    assert conclusion.identification is None
    assert not summary.valid
    assert summary.estimators == {}
    (problem,) = summary.problems
    assert NAMES[missing] in problem or f"joint {missing + 1}" in problem
    assert [trial.k for trial in summary.trials] == [2 - missing]


def test_without_any_trial_expect_an_invalid_result() -> None:
    summary = conclusion_of([]).summary

    assert not summary.valid
    assert len(summary.problems) == 1
    assert summary.trials == []
    assert summary.truth is not None


def test_known_problems_make_a_result_invalid_and_come_first() -> None:
    summary = conclusion_of(problems=["the roof fell in"]).summary

    assert (summary.valid, summary.problems) == (False, ["the roof fell in"])
    assert set(summary.estimators) == set(ESTIMATORS)
    bare = conclusion_of([], problems=["the roof fell in"]).summary
    assert bare.problems[0] == "the roof fell in"
    assert len(bare.problems) == 2


def test_when_samples_are_lost_expect_a_refusal_with_the_account() -> None:
    messages = list(RECORDING.messages)
    of_torque = [i for i, message in enumerate(messages) if message[0] == DATA_STREAMS[1]]
    for i in reversed(of_torque[3000:3004]):
        del messages[i]

    conclusion = conclusion_of(record(None, messages))

    assert conclusion.identification is None
    assert [trial.lost for trial in conclusion.summary.trials] == [4, 0]
    assert conclusion.summary.problems[0] == (
        "trial 1: 4 samples of torque_sensors are missing between 2.940 s and 2.944 s; "
        "--allow-gaps uses the intact parts"
    )
    assert all(math.isnan(value) for value in conclusion.summary.trials[0].lock_ratio)


def test_when_a_joint_was_perturbed_twice_and_another_never_expect_a_refusal() -> None:
    assert not conclusion_of([LIVE[0], LIVE[0]]).summary.valid


@pytest.mark.parametrize("truth", [None, "null"])
def test_without_a_truth_there_is_no_vaf(truth: str | None) -> None:
    metadata = {key: value for key, value in METADATA.items() if key != "truth"}
    if truth is not None:
        metadata["truth"] = truth

    summary = conclusion_of(metadata=metadata).summary

    assert summary.valid
    assert summary.truth is None
    assert [result.vaf for result in summary.estimators.values()] == [None, None]


def test_without_metadata_the_seed_is_that_of_the_trials() -> None:
    summary = conclusion_of(metadata={}).summary

    assert summary.valid
    assert summary.seed == RECORDING.records[0].seed


@pytest.mark.parametrize("truth", ["{}", "[1]", '{"M": [[1]], "B": 2, "K": 3}', "{", "7"])
def test_when_the_truth_makes_no_sense_expect_an_error_in_one_line(truth: str) -> None:
    with pytest.raises(DataError, match=r"^metadata: truth is not .*") as caught:
        truth_of({"truth": truth})
    assert "\n" not in str(caught.value)


def test_files_hold_the_result_and_are_never_overwritten(tmp_path: Path) -> None:
    conclusion = conclusion_of()

    conclusion.write(tmp_path)

    assert read_summary(tmp_path / "summary.json").estimators == conclusion.summary.estimators
    assert set(read_frf(tmp_path / "frf.npz")) == set(ESTIMATORS)
    with pytest.raises(DataError, match="exists already"):
        conclusion.write(tmp_path)
    (tmp_path / "bare").mkdir()
    conclusion_of([]).write(tmp_path / "bare")
    assert [path.name for path in (tmp_path / "bare").iterdir()] == ["summary.json"]


def test_bag_and_speed_of_each_trial_are_passed_on() -> None:
    trials = conclusion_of(
        [replace(trial, bag="somewhere", rtf=2.5) for trial in LIVE]
    ).summary.trials

    assert [(trial.bag, trial.rtf) for trial in trials] == [("somewhere", 2.5)] * 2


def test_torques_are_taken_as_read_before_the_update_unless_the_metadata_say_otherwise() -> None:
    assert reading_of({}) == TorqueReading()
    mean = reading_of({"torque_timing": '"interval_mean"'})
    assert mean == TorqueReading(timing=TorqueTiming.INTERVAL_MEAN)


@pytest.mark.parametrize("told", ['"later"', "7", "null", "[1]"])
def test_when_the_timing_makes_no_sense_expect_an_error_that_names_what_there_is(told: str) -> None:
    with pytest.raises(DataError, match=r"torque_timing is .*known are unknown, before_update"):
        reading_of({"torque_timing": told})
