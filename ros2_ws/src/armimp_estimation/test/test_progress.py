"""Running coherence: what people see while a trial is recorded is what the result will say."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common import topics
from armimp_common.cdr import CommandEncoder, JointStateEncoder
from armimp_common.topics import COMMANDS, JOINT_STATES, PERIOD_NS, PERTURBATION, TORQUE_SENSORS
from armimp_estimation import scores
from armimp_estimation.alignment.trial_streams import decode_streams
from armimp_estimation.estimators.lpm import FittedColumn, LpmConfig, LpmFull
from armimp_estimation.progress import RunningTrial
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData
from support.recordings import recorded_arm
from support.synthetic_trials import TWO_JOINT_ARM as ARM
from support.synthetic_trials import SyntheticConfig, synthetic_trial

STREAMS = (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)
SAMPLES = 10_000
RECORDING = recorded_arm(SAMPLES)
NAMES = RECORDING.records[0].joint_names
WELCH = WelchConfig.for_samples(SAMPLES)

Messages = dict[str, list[bytes]]


def messages_of(joint: int, names: tuple[str, ...] = NAMES) -> Messages:
    """Messages of a trial, with the joints in this order."""
    record = RECORDING.records[joint]
    order = [NAMES.index(name) for name in names]
    rows = (record.perturbation[order], record.position[order], record.torque[order])
    return {
        topic: [encoder.encode(k * PERIOD_NS, values[:, k]) for k in range(SAMPLES)]
        for topic, values, encoder in (
            (topic, values, JointStateEncoder(names, topics.VALUE_FIELD[topic]))
            for topic, values in zip(STREAMS, rows, strict=True)
        )
    }


TRIALS = [messages_of(joint) for joint in range(2)]


def first(messages: Messages, count: int) -> Messages:
    return {topic: raws[:count] for topic, raws in messages.items()}


def running(joint: int) -> RunningTrial:
    return RunningTrial(NAMES, joint, rate=1000.0, planned=SAMPLES)


def final(joint: int) -> tuple[float, float]:
    trial = TrialData.from_record(RECORDING.records[joint], WELCH).spectra
    motion = scores.coherence(trial.spectra, 0, trial.position_channel(joint))
    torque = scores.coherence(trial.spectra, 0, trial.torque_channel(joint))
    return float(np.mean(motion)), float(np.mean(torque))


@pytest.mark.parametrize("joint", [0, 1])
@settings(max_examples=10, deadline=None)
@given(stops=st.lists(st.integers(0, SAMPLES), max_size=8))
def test_figures_of_the_whole_trial_are_those_of_the_final_spectra_however_it_arrived(
    joint: int, stops: list[int]
) -> None:
    coherence = running(joint)
    for stop in sorted(stops):
        coherence.update(first(TRIALS[joint], stop))

    assert coherence.update(TRIALS[joint]) == final(joint)
    assert coherence.update(TRIALS[joint]) == final(joint)


def test_joint_order_comes_from_the_names() -> None:
    assert running(1).update(messages_of(1, NAMES[::-1])) == final(1)


def test_nothing_is_told_before_two_segments_are_complete() -> None:
    coherence = running(0)
    two_segments = WELCH.segment + WELCH.step

    assert coherence.update(first(TRIALS[0], 0)) is None
    assert coherence.update(first(TRIALS[0], WELCH.segment)) is None
    assert coherence.update(first(TRIALS[0], two_segments - 1)) is None
    told = coherence.update(first(TRIALS[0], two_segments))
    assert told is not None
    assert min(told) > 0.9


def test_only_samples_that_all_streams_have_are_used() -> None:
    coherence = running(0)
    messages = dict(TRIALS[0])
    messages[TORQUE_SENSORS] = messages[TORQUE_SENSORS][: WELCH.segment]

    assert coherence.update(messages) is None
    assert coherence.update(TRIALS[0]) == final(0)


@pytest.mark.parametrize("bad", [b"rubbish", JointStateEncoder(("a",), "effort").encode(0, (1.0,))])
def test_when_a_message_cannot_be_used_expect_silence(bad: bytes) -> None:
    coherence = running(0)
    messages = dict(TRIALS[0])
    messages[TORQUE_SENSORS] = list(messages[TORQUE_SENSORS])
    messages[TORQUE_SENSORS][SAMPLES // 2] = bad

    assert coherence.update(first(messages, SAMPLES // 2)) is not None
    assert coherence.update(messages) is None
    assert coherence.update(messages) is None


def test_when_a_reading_is_not_finite_expect_silence() -> None:
    nan = JointStateEncoder(NAMES, "effort").encode(0, (float("nan"), 0.0))
    messages = dict(TRIALS[0])
    messages[TORQUE_SENSORS] = [nan, *messages[TORQUE_SENSORS][1:]]

    assert running(0).update(messages) is None


@pytest.mark.parametrize("planned", [0, 1, 100, 1500])
def test_trial_too_short_for_spectra_is_endured(planned: int) -> None:
    coherence = RunningTrial(NAMES, 0, rate=1000.0, planned=planned)

    assert coherence.update(first(TRIALS[0], min(planned, 1000))) is None


def with_commands(joint: int) -> Messages:
    commands = CommandEncoder(len(NAMES))
    values = RECORDING.records[joint].perturbation
    return {**TRIALS[joint], COMMANDS: [commands.encode(values[:, k]) for k in range(SAMPLES)]}


def expected_column(joint: int, samples: int, *, commands: bool = False) -> FittedColumn:
    record = RECORDING.records[joint]
    cut = {name: getattr(record, name)[:, :samples] for name in ("position", "torque")}
    perturbation = record.perturbation[:, :samples]
    return LpmFull().column(
        replace(
            record, **cut, perturbation=perturbation, command=perturbation if commands else None
        )
    )


def assert_same(found: FittedColumn | None, expected: FittedColumn) -> None:
    assert found is not None
    assert found.joint == expected.joint
    assert found.values.tobytes() == expected.values.tobytes()
    assert found.errors.tobytes() == expected.errors.tobytes()


@pytest.mark.parametrize("joint", [0, 1])
@settings(max_examples=10, deadline=None)
@given(stops=st.lists(st.integers(0, SAMPLES), max_size=8), samples=st.integers(3000, SAMPLES))
def test_column_depends_on_the_samples_alone_however_they_arrived(
    joint: int, stops: list[int], samples: int
) -> None:
    trial = running(joint)
    for stop in sorted(stops):
        trial.update(first(TRIALS[joint], stop))

    assert_same(trial.column(TRIALS[joint], samples), expected_column(joint, samples))
    assert_same(trial.column(TRIALS[joint]), expected_column(joint, SAMPLES))


def test_commands_take_part_in_the_column() -> None:
    assert_same(running(0).column(with_commands(0), 8000), expected_column(0, 8000, commands=True))


def test_column_has_the_true_values_within_its_errors() -> None:
    record = RECORDING.records[1]
    found = LpmFull(
        config=LpmConfig(reading=TorqueReading(timing=TorqueTiming.SIMULTANEOUS))
    ).column(record)
    true = np.stack([matrix[:, 1] for matrix in (ARM.M, ARM.B, ARM.K)])
    assert (np.abs(found.values - true) < 0.02 * np.abs(true)).all()


def test_the_last_trial_accounts_for_motion_of_locked_joints_and_the_first_says_so() -> None:
    # A soft lock, so that without the trials before the column is far off.
    config = SyntheticConfig(samples=SAMPLES, lock_stiffness=3e3, torque_noise=0.01)
    records = [synthetic_trial(ARM, joint, config, seed=joint) for joint in range(2)]
    lpm = LpmFull(config=LpmConfig(reading=TorqueReading(timing=TorqueTiming.SIMULTANEOUS)))
    true = np.stack([matrix[:, 1] for matrix in (ARM.M, ARM.B, ARM.K)])

    alone, last = lpm.column(records[1]), lpm.column(records[1], records[:1])
    assert alone.preliminary
    assert not last.preliminary
    assert (np.abs(alone.values - true) / np.abs(true)).max() > 0.5
    assert (np.abs(last.values - true) / last.errors).max() < 4.0


def test_when_commands_cannot_be_decoded_expect_the_column_without_them() -> None:
    messages = with_commands(0)
    messages[COMMANDS][10] = b"rubbish"
    assert_same(running(0).column(messages), expected_column(0, SAMPLES))


def test_when_samples_are_too_few_expect_no_column() -> None:
    trial = running(0)
    for count in (0, 1, 10):
        assert trial.column(first(TRIALS[0], count)) is None
    assert trial.column(first(TRIALS[0], SAMPLES // 2), SAMPLES) is None
    assert trial.column(TRIALS[0], 0) is None


@pytest.mark.parametrize("topic", STREAMS)
def test_when_a_sample_is_missing_expect_no_column_but_the_coherence(topic: str) -> None:
    messages = dict(TRIALS[0])
    messages[topic] = [*messages[topic][:100], *messages[topic][101:]]
    trial = running(0)

    assert trial.update(messages) is not None
    assert trial.column(messages) is None


def test_when_all_streams_lack_a_sample_expect_no_column() -> None:
    messages = {topic: [*raws[:100], *raws[101:]] for topic, raws in TRIALS[0].items()}
    assert running(0).column(messages) is None


@settings(max_examples=10, deadline=None)
@given(stops=st.lists(st.integers(0, SAMPLES), max_size=8))
def test_streams_are_those_that_decoding_all_at_once_gives(stops: list[int]) -> None:
    messages = with_commands(1)
    trial = running(1)
    for stop in sorted(stops):
        trial.update(first(messages, stop))
    found, expected = trial.streams(messages), decode_streams(NAMES, messages)

    assert found is not None
    assert (found.joint_names, found.commands) == (expected.joint_names, expected.commands)
    assert found.command_values is not None
    assert expected.command_values is not None
    assert found.command_values.tobytes() == expected.command_values.tobytes()
    assert list(found.stamped) == list(expected.stamped)
    for topic, stream in found.stamped.items():
        other = expected.stamped[topic]
        assert stream.stamps.tobytes() == other.stamps.tobytes()
        assert stream.values.tobytes() == other.values.tobytes()
        assert stream.values.flags.c_contiguous
        assert (stream.malformed, stream.defect) == (0, "")


def test_a_missing_command_is_missing_in_the_streams() -> None:
    messages = with_commands(0)
    del messages[COMMANDS][500]
    found, expected = running(0).streams(messages), decode_streams(NAMES, messages)
    assert found is not None
    assert found.commands == expected.commands == SAMPLES - 1
    np.testing.assert_array_equal(found.command_values, expected.command_values)


@pytest.mark.parametrize(
    ("topic", "raws"),
    [
        (COMMANDS, [b"rubbish"]),
        *((topic, raws) for topic in STREAMS for raws in ([], [b"rubbish"])),
    ],
)
def test_when_a_message_is_missing_or_cannot_be_used_expect_no_streams(
    topic: str, raws: list[bytes]
) -> None:
    messages = with_commands(0)
    messages[topic] = [*messages[topic][:500], *raws, *messages[topic][501:]]
    trial = running(0)
    trial.update(first(messages, 300))
    assert trial.streams(messages) is None


def test_when_messages_were_given_back_expect_no_streams() -> None:
    messages = with_commands(0)
    trial = running(0)
    trial.update(messages)
    assert trial.streams(first(messages, SAMPLES - 1)) is None


def test_without_samples_there_are_no_streams() -> None:
    assert running(0).streams(first(with_commands(0), 0)) is None
