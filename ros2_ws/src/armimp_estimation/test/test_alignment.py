"""Trials assembled from streams: windows, records, account of every sample, and refusals."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common.cdr import CommandDecoder, CommandEncoder, JointStateEncoder
from armimp_common.errors import DataError
from armimp_common.status import Cause, Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
)
from armimp_estimation.alignment.assemble import MOST_EXCLUDED, Trial
from armimp_estimation.alignment.trial_windows import (
    MOST_TICKS,
    infer_windows,
    judge_stamps,
    sampling_period,
    windows_from_statuses,
)
from armimp_estimation.problems import Problem, ProblemCode, Severity
from support.problems import codes, having
from support.streams import Topics, changed, statuses_of, trials_of
from support.synthetic_bags import SyntheticRecording, assert_same, synthetic_recording

NAMES = ("shoulder", "elbow")
STAMPED = (JOINT_STATES, TORQUE_SENSORS, PERTURBATION)
TICKS = 40
RECORDING = synthetic_recording(ticks=TICKS, settle=10, rest=10)
WHOLE = synthetic_recording(ticks=TICKS)
"""A recording of the trial alone."""
FIRST = 10
START = RECORDING.records[0].start_ns
STATUSES = statuses_of(RECORDING.by_topic())
ENCODE = CommandEncoder(len(NAMES)).encode


def assemble(topics: Topics, statuses: Sequence[TrialStatus] | None = None) -> Trial:
    (trial,) = trials_of(topics, statuses)
    return trial


def only(trial: Trial, code: ProblemCode) -> Problem:
    """The only problem of a trial, which has this code."""
    (problem,) = trial.problems
    assert (problem.code, problem.trial) == (code, 1)
    return problem


def assert_refused(trial: Trial, code: ProblemCode, *, healed: bool) -> None:
    """Check a refusal for one reason; `healed` if the intact parts may be used all the same."""
    with pytest.raises(DataError) as caught:
        trial.intact()
    assert ("--allow-gaps" in str(caught.value)) == healed
    assert codes(trial.refusals) == [code]
    allowed = replace(trial, allow_gaps=True)
    assert codes(allowed.refusals) == [code] * (not healed)
    judged, *_ = having(allowed.judged, code)
    assert (judged.severity is Severity.NOTE) == healed


def effort(stamp_ns: int, values: Sequence[float]) -> bytes:
    return JointStateEncoder(NAMES, "effort").encode(stamp_ns, values)


def numbered(count: int) -> list[bytes]:
    return [ENCODE((0.0, 0.0), number) for number in range(1, count + 1)]


def test_statuses_give_one_window_per_perturbation_however_often_they_are_repeated() -> None:
    several = synthetic_recording(perturbed=(1, 0), ticks=9, settle=3, rest=2)
    statuses = statuses_of(several.by_topic())
    windows = windows_from_statuses(statuses)
    assert [(one.trial, one.joint, one.ended) for one in windows] == [(1, 1, True), (2, 0, True)]
    # A latched topic repeats statuses, and others tell of progress.
    progress = changed(statuses[1], tick=statuses[1].tick + 20)
    again = [statuses[5], *statuses[:2], progress, *statuses[2:], statuses[5], statuses[5]]
    assert set(windows_from_statuses(again)) == set(windows)
    # A window is open until something follows.
    assert not windows_from_statuses(statuses[:1])
    assert [one.ended for one in windows_from_statuses(statuses[:5])] == [True, False]


@pytest.mark.parametrize(("ticks", "start"), [(MOST_TICKS + 1, START), (10, 10**30)])
def test_impossible_announcements_are_refused(ticks: int, start: int) -> None:
    statuses = [
        changed(status, ticks=ticks, start_ns=status.start_ns and start) for status in STATUSES
    ]
    with pytest.raises(DataError, match="trial 1 cannot"):
        windows_from_statuses(statuses)


def test_a_pause_of_a_quarter_of_a_second_or_another_joint_divides_what_is_inferred() -> None:
    stamps = START + np.arange(1000, dtype=np.int64) * PERIOD_NS
    perturbation = np.zeros((2, 1000))
    perturbation[1, 10:400] = perturbation[1, 649:990] = 1.0
    perturbation[0, 500] = np.nan
    (window,) = infer_windows(stamps, perturbation)
    assert (window.joint, window.ticks) == (1, 980)
    perturbation[1, 649] = 0.0
    perturbation[0, 990:] = 1.0
    found = infer_windows(stamps, perturbation)
    assert [(one.joint, one.ticks) for one in found] == [(1, 390), (1, 340), (0, 10)]
    pulses = np.tile(np.arange(600) < 4, 24) * (np.arange(14_400) // 7200 == [[0], [1]])
    pulses[0, 3000:4800] = 0.0  # two trials of the first joint
    found = infer_windows(START + np.arange(14_400, dtype=np.int64) * PERIOD_NS, 1.0 * pulses)
    assert [(one.joint, one.ticks) for one in found] == [(0, 2404), (0, 1804), (1, 6604)]
    (few,) = infer_windows(
        START + np.arange(2400, dtype=np.int64) * PERIOD_NS, 1.0 * pulses[:, :2400]
    )
    assert (few.joint, few.ticks) == (0, 1804)


@pytest.mark.parametrize(
    ("values", "reason"),
    [([0.0, 0.0, 0.0], "no joint is perturbed"), ([1.0, 0.0, 2.0], "joints 1, 3 are perturbed")],
)
def test_what_cannot_be_inferred_is_refused(values: list[float], reason: str) -> None:
    with pytest.raises(DataError, match=reason):
        infer_windows(np.array([START], np.int64), np.array(values)[:, None])


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_every_injected_fault_is_counted_and_only_those(data: st.DataObject) -> None:
    topics = RECORDING.by_topic()
    missing: set[int] = set()
    for topic in STAMPED:
        ticks = st.integers(0, TICKS - 1)
        lost = data.draw(st.sets(ticks, max_size=6), label=f"lost of {topic}")
        twice = data.draw(st.sets(ticks, max_size=6), label=f"twice of {topic}") - lost
        kept = [
            raw
            for tick, raw in enumerate(topics[topic], -FIRST)
            for raw in [raw] * (0 if tick in lost else 2 if tick in twice else 1)
        ]
        topics[topic] = kept
        missing |= lost
    trial = assemble(topics)
    found = having(trial.problems, ProblemCode.SAMPLES_MISSING)
    assert sum(int(one.values["count"]) for one in found) <= trial.statistics.lost
    assert bool(found) == bool(missing)
    assert trial.statistics.excluded == len(missing)
    for topic in STAMPED:
        count = trial.statistics.streams[topic]
        assert count.received == count.expected - count.lost + count.duplicated
    present = [tick for tick in range(TICKS) if tick not in missing]
    runs = np.split(present, np.flatnonzero(np.diff(present) != 1) + 1)
    long_runs = [run for run in runs if len(run) > 1]
    assert len(trial.segments) == len(long_runs)
    for segment, run in zip(trial.segments, long_runs, strict=True):
        assert_same(segment, RECORDING.records[0], int(run[0]), int(run[-1]) + 1)


@pytest.mark.parametrize("topic", STAMPED)
def test_exchange_of_two_samples_is_one_reordered(topic: str) -> None:
    topics = RECORDING.by_topic()
    raws = topics[topic]
    raws[FIRST + 5], raws[FIRST + 6] = raws[FIRST + 6], raws[FIRST + 5]
    trial = assemble(topics)
    problem = only(trial, ProblemCode.SAMPLES_REORDERED)
    assert problem.values == {"stream": topic, "count": 1}
    assert_refused(trial, ProblemCode.SAMPLES_REORDERED, healed=True)
    assert_same(replace(trial, allow_gaps=True).intact()[0], RECORDING.records[0], 0, TICKS)


@pytest.mark.parametrize("after", [0, 1, 9])
@pytest.mark.parametrize("value", [99.0, np.nan])
def test_of_two_messages_that_contradict_each_other_none_is_used(after: int, value: float) -> None:
    topics = RECORDING.by_topic()
    other = effort(START + 3 * PERIOD_NS, (99.0, value))
    topics[TORQUE_SENSORS].insert(FIRST + 3 + after, other)
    trial = assemble(topics)
    assert [segment.samples for segment in trial.segments] == [3, TICKS - 4]
    count = trial.statistics.streams[TORQUE_SENSORS]
    assert (count.lost, count.duplicated, count.contradictory) == (0, 1, 1)
    assert trial.statistics.excluded == 1
    assert ProblemCode.SAMPLES_CONTRADICTORY in codes(trial.problems)
    assert not replace(trial, allow_gaps=True).refusals


def test_malformed_messages_count_as_lost_and_are_named() -> None:
    topics = RECORDING.by_topic()
    topics[JOINT_STATES][FIRST + 2 : FIRST + 4] = [b"\0\1\0\0rubbish", b""]
    trial = assemble(topics)
    assert trial.statistics.streams[JOINT_STATES].lost == 2
    malformed = trial.problems[codes(trial.problems).index(ProblemCode.SAMPLES_MALFORMED)]
    assert malformed.values["count"] == 2
    assert "JointState is truncated" in str(malformed.values["reason"])


@pytest.mark.parametrize("raws", [[b"rubbish"] * 3, []])
def test_stream_without_any_good_message_is_an_error(raws: list[bytes]) -> None:
    with pytest.raises(DataError, match="joint_states"):
        assemble({**RECORDING.by_topic(), JOINT_STATES: raws})


def test_samples_that_are_not_finite_divide_the_record() -> None:
    topics = RECORDING.by_topic()
    for tick in (9, 20):
        stamp = START + tick * PERIOD_NS
        topics[TORQUE_SENSORS][FIRST + tick] = effort(stamp, (float("inf"), 0.0))
    trial = assemble(topics)
    assert [segment.samples for segment in trial.segments] == [9, 10, TICKS - 21]
    where = {"count": 2, "first": 0.009, "last": 0.021}
    problem = only(trial, ProblemCode.SAMPLES_NOT_FINITE)
    assert problem.values == {"stream": TORQUE_SENSORS, **where}
    assert_refused(trial, ProblemCode.SAMPLES_NOT_FINITE, healed=True)


def with_torque_stamps(shift: Callable[[int], float]) -> Trial:
    topics = RECORDING.by_topic()
    topics[TORQUE_SENSORS] = [
        effort(START + round((k - FIRST + shift(k)) * PERIOD_NS), (float(k - FIRST), 0.0))
        for k in range(TICKS + 20)
    ]
    return assemble(topics)


@pytest.mark.parametrize("later", [-0.3, -0.1, 0.1, 0.3])
def test_streams_stamped_a_fraction_of_a_period_apart_are_paired_with_a_note(later: float) -> None:
    trial = with_torque_stamps(lambda _: later)
    apart = only(trial, ProblemCode.STAMPS_APART)
    assert apart.severity is Severity.NOTE
    assert apart.values["apart_ms"] == pytest.approx(later)
    (record,) = trial.intact()
    np.testing.assert_array_equal(record.torque[0], np.arange(TICKS))


@pytest.mark.parametrize("shift", [lambda _: 0.5, lambda k: 0.03 * k])
def test_streams_whose_samples_cannot_be_paired_are_refused_with_that_alone(
    shift: Callable[[int], float],
) -> None:
    trial = with_torque_stamps(shift)
    assert only(trial, ProblemCode.STAMPS_DISAGREE).values["stream"] == TORQUE_SENSORS
    assert replace(trial, allow_gaps=True).refusals


def test_perturbation_of_zero_is_refused() -> None:
    topics = RECORDING.by_topic()
    stamps = range(START - FIRST * PERIOD_NS, START + (TICKS + 10) * PERIOD_NS, PERIOD_NS)
    topics[PERTURBATION] = [effort(stamp, (0.0, 0.0)) for stamp in stamps]
    assert_refused(assemble(topics), ProblemCode.NO_PERTURBATION, healed=False)


def test_unknown_perturbed_joint_is_refused() -> None:
    statuses = [changed(status, joint_name="wrist") for status in STATUSES]
    trial = assemble(RECORDING.by_topic(), statuses)
    assert trial.problems[0].values == {"name": "wrist", "known": "shoulder, elbow"}
    assert trial.segments == ()
    with pytest.raises(DataError, match="wrist is none of"):
        replace(trial, allow_gaps=True).intact()


def not_finite(commands: list[bytes]) -> list[bytes]:
    """The commands with a NaN in one of those of the first trial."""
    return [*commands[:20], commands[20][:-8] + np.array([np.nan]).tobytes(), *commands[21:]]


@pytest.mark.parametrize(
    ("spoil", "known"),
    [
        (lambda commands: commands, [True, True]),
        (lambda commands: commands[:-1], [True, True]),  # cut within a tick
        (lambda commands: commands[:0], [False, False]),
        (lambda commands: commands[:60], [False, False]),
        (lambda commands: commands[2:], [False, False]),
        (lambda commands: [*commands[:3], b"rubbish", *commands[4:]], [False, False]),
        (not_finite, [False, True]),
    ],
    ids=["all", "cut", "none", "half", "late", "malformed", "not finite"],
)
def test_each_sample_has_the_command_that_answered_it_unless_that_is_not_known(
    spoil: Callable[[list[bytes]], list[bytes]], known: list[bool]
) -> None:
    several = synthetic_recording(perturbed=(0, 1), ticks=40, settle=10, rest=5)
    topics = several.by_topic()
    topics[COMMANDS] = spoil(topics[COMMANDS])
    records = [trial.segments[0] for trial in trials_of(topics)]
    assert [record.command is not None for record in records] == known
    for record in records:
        if record.command is not None:
            # The synthetic recording makes its commands so.
            np.testing.assert_array_equal(record.command, record.torque + record.perturbation)


@pytest.mark.parametrize("with_numbers", [False, True])
def test_fewer_commands_than_samples_are_a_problem_that_gaps_may_heal(with_numbers: bool) -> None:
    topics = WHOLE.by_topic()
    if with_numbers:
        topics[COMMANDS] = numbered(TICKS)
    del topics[COMMANDS][7:9]
    trial = assemble(topics)
    assert trial.statistics.streams[COMMANDS].lost == trial.statistics.lost == 2
    assert only(trial, ProblemCode.COMMANDS_MISSING).values == {"count": 2}
    assert_refused(trial, ProblemCode.COMMANDS_MISSING, healed=True)
    assert trial.segments[0].command is None


def test_more_commands_than_samples_are_a_problem_that_nothing_heals() -> None:
    topics = WHOLE.by_topic()
    topics[COMMANDS][7:7] = topics[COMMANDS][:3]
    assert_refused(assemble(topics), ProblemCode.COMMANDS_FOREIGN, healed=False)


@pytest.mark.parametrize(
    ("recording", "place", "number"),
    [(WHOLE, 7, number) for number in (0, 1, 7, 8)]
    + [(RECORDING, FIRST - 1, number) for number in (0, 1, FIRST, 2 * TICKS)],
)
def test_a_numbered_command_of_somebody_else_is_found_though_as_many_are_left(
    recording: SyntheticRecording, place: int, number: int
) -> None:
    topics = recording.by_topic()
    commands = topics[COMMANDS] = numbered(len(topics[COMMANDS]))
    assert not assemble(topics).problems
    stray = ENCODE((0.0, 0.0), number)
    topics[COMMANDS] = [*commands[:place], stray, *commands[place:-1]]
    assert ProblemCode.COMMANDS_FOREIGN in codes(assemble(topics).problems)


@pytest.mark.parametrize("rest", [0, 4])
def test_commands_that_are_numbered_anew_for_each_trial_belong_to_their_samples(rest: int) -> None:
    several = synthetic_recording(perturbed=(0, 1), ticks=TICKS, settle=rest)
    topics = several.by_topic()
    expected = [trial.intact()[0].command for trial in trials_of(topics)]
    decode = CommandDecoder(len(NAMES)).decode
    topics[COMMANDS] = [
        ENCODE(decode(raw)[1], index % (TICKS + rest) + 1)
        for index, raw in enumerate(topics[COMMANDS])
    ]
    trials = trials_of(topics)
    for trial, command in zip(trials, expected, strict=True):
        (found,) = trial.intact()
        assert found.command is not None
        np.testing.assert_array_equal(found.command, command)


@pytest.mark.parametrize(
    ("intervals", "count", "parts", "excluded"),
    [("10-12 35-35", 4, [10, 21, 3], 6), ("38-70", 9, [38], 2)],
)
def test_what_follows_clipped_commands_is_left_out_without_being_asked(
    intervals: str, count: int, parts: list[int], excluded: int
) -> None:
    *others, last = STATUSES
    statuses = [*others, changed(last, clipped=count, clipped_intervals=intervals)]
    trial = assemble(RECORDING.by_topic(), statuses)
    # Each acts until the next sample.
    assert [part.samples for part in trial.intact()] == parts
    assert (trial.statistics.clipped, trial.statistics.excluded) == (count, excluded)
    share = excluded / TICKS
    expected = [(ProblemCode.MUCH_EXCLUDED, 100.0 * share)] if share > MOST_EXCLUDED else []
    assert [(one.code, one.values["percent"]) for one in trial.judged] == expected


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(1, 4 * (TICKS + 10)))
def test_cut_recording_gives_all_complete_periods(cut: int) -> None:
    recording = synthetic_recording(ticks=TICKS, settle=10)
    topics = replace(recording, messages=recording.messages[:-cut]).by_topic()
    if not any(status.phase is Phase.PERTURB for status in statuses_of(topics)):
        assert PERTURBATION not in topics or trials_of(topics) == []
        return
    trial = assemble(topics)
    complete = min(len(topics[topic]) for topic in STAMPED) - 10
    assert trial.statistics.span == complete
    assert trial.statistics.lost == 0
    if complete > 1:
        assert_same(trial.intact()[0], recording.records[0], 0, complete)
    if 1 < complete < TICKS:
        short = only(trial, ProblemCode.CUT_SHORT)
        assert short.severity is Severity.NOTE
        assert str(short) == f"trial 1: cut short: {complete} of {TICKS} samples are there"


@pytest.mark.parametrize(
    ("cause", "code", "healed"),
    [
        (Cause.LIMIT, ProblemCode.TRIAL_SPOILED, False),
        (Cause.SAMPLES_LOST, ProblemCode.SAMPLES_LOST, True),
    ],
)
def test_trial_that_the_controller_finds_not_valid_is_refused(
    cause: Cause, code: ProblemCode, healed: bool
) -> None:
    spoiled = changed(STATUSES[1], valid=False, cause=cause, reason="so it is")
    trial = assemble(RECORDING.by_topic(), [*STATUSES[:2], spoiled, *STATUSES[2:]])
    assert only(trial, code).values == {"reason": "so it is"}
    assert_refused(trial, code, healed=healed)
    assert trial.segments[0].samples == TICKS


def test_trials_before_the_recording_began_are_passed_over() -> None:
    # A latched topic repeats the statuses of trials that are over.
    several = synthetic_recording(perturbed=(0, 1), ticks=TICKS, settle=10, rest=10)
    topics = several.by_topic()
    for topic in DATA_STREAMS:
        del topics[topic][: TICKS + 15]
    (trial,) = trials_of(topics)
    assert_same(trial.intact()[0], several.records[1], 0, TICKS)


@pytest.mark.parametrize(
    ("statuses", "code"),
    [(3, ProblemCode.SAMPLES_MISSING), (2, ProblemCode.NOTHING_RECORDED)],
)
def test_trial_without_any_sample_is_refused(statuses: int, code: ProblemCode) -> None:
    topics = RECORDING.by_topic()
    for topic in STAMPED:
        del topics[topic][FIRST:]
    trial = assemble(topics, STATUSES[:statuses])
    assert trial.segments == ()
    assert code in codes(trial.problems)
    with pytest.raises(DataError, match="trial 1"):
        replace(trial, allow_gaps=True).intact()


# --- The sampling rate from stamps: what is taken, and what is found wrong ----------------------

BEGIN = 1_700_000_000_000_000_000


def stamps(rate: float, later: float | np.ndarray = 0.0) -> np.ndarray:
    """Stamps (ns) at a rate (Hz), each of them later by so much (ns)."""
    return BEGIN + np.rint(np.arange(4000) * (1e9 / rate) + later).astype(np.int64)


NOISE = np.random.default_rng(1).normal(size=4000)


@pytest.mark.parametrize(
    ("values", "rate", "expected"),
    [
        *((stamps(rate), rate, []) for rate in (200.0, 1e3 / 3.0, 500.0, 512.0, 800.0, 1e3, 4e3)),
        *((stamps(rate), rate, [ProblemCode.RATE_UNCUSTOMARY]) for rate in (980.0, 1020.0, 900.0)),
        (
            stamps(1000.0, 2.5 * np.arange(4000) ** 2),  # faster and faster
            990.1,
            [ProblemCode.RATE_UNCUSTOMARY, ProblemCode.RATE_DRIFTS],
        ),
        (stamps(1000.0, 3e5 * np.clip(NOISE, -1.4, 1.4)), 1000.0, [ProblemCode.STAMPS_IRREGULAR]),
        (stamps(1000.0, 2e4 * NOISE), 1000.0, []),
    ],
)
def test_the_rate_is_that_of_the_stamps_with_all_that_is_wrong_with_them(
    values: np.ndarray, rate: float, expected: list[ProblemCode]
) -> None:
    streams = {"joint_states": values}
    period = sampling_period(streams)
    assert 1e9 / period == pytest.approx(rate, rel=1e-4)
    assert codes(judge_stamps(streams, period)) == expected


def test_when_streams_have_different_rates_expect_the_one_that_differs() -> None:
    streams = {name: stamps(1000.0) for name in ("a", "b")} | {"c": stamps(995.0)}
    (found,) = judge_stamps(streams, sampling_period(streams))
    assert (found.code, found.values["stream"]) == (ProblemCode.STREAM_RATES_DIFFER, "c")


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (stamps(100.0), "100 Hz"),
        (stamps(8000.0), "8000 Hz"),
        (np.zeros(4000, np.int64), "joint_states have 1 different stamps"),
    ],
)
def test_stamps_without_a_rate_that_is_taken_are_refused(values: np.ndarray, reason: str) -> None:
    with pytest.raises(DataError, match=reason):
        sampling_period({"joint_states": values})
