"""Running coherence: what people see while a trial is recorded is what the result will say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common import contract
from armimp_common.cdr import JointStateEncoder
from armimp_common.contract import JOINT_STATES, PERTURBATION, TORQUE_SENSORS
from armimp_estimation import scores
from armimp_estimation.progress import RunningTrial
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.testing import recorded_arm
from armimp_estimation.trial import TrialData

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
        topic: [encoder.encode(k, values[:, k]) for k in range(SAMPLES)]
        for topic, values, encoder in (
            (topic, values, JointStateEncoder(names, contract.VALUE_FIELD[topic]))
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
