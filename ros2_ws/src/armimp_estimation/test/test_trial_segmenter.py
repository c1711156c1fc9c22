"""Segmenter: whatever the interleaving, exactly the messages of each trial."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common.cdr import CommandEncoder, JointStateEncoder, stamp_of
from armimp_common.errors import MalformedMessageError
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    TRIAL,
)
from armimp_estimation.alignment.streams import Streams
from armimp_estimation.alignment.trial_segmenter import TrialSegmenter
from armimp_estimation.bags.statuses import decode_trial_status
from support.streams import fed_synchronizer
from support.synthetic_bags import SyntheticRecording, synthetic_recording

SETTLE, TICKS, REST = 4, 30, 5
LENGTH = SETTLE + TICKS + REST
RECORDING = synthetic_recording(perturbed=(0, 1, 0), ticks=TICKS, settle=SETTLE, rest=REST)
TOPICS = (*DATA_STREAMS, TRIAL)
STAMPED = (JOINT_STATES, TORQUE_SENSORS, PERTURBATION)

Messages = dict[str, list[bytes]]
Turns = Sequence[tuple[str, int]]


def statuses_of(recording: SyntheticRecording) -> list[TrialStatus]:
    statuses = [decode_trial_status(raw) for raw in recording.by_topic()[TRIAL]]
    return [*statuses, replace(statuses[-1], phase=Phase.DONE)]


@dataclass
class Collected:
    """A trial, with its messages as they went to the sink."""

    statuses: tuple[TrialStatus, ...]
    messages: Messages


class Desk:
    """A segmenter with a diary; messages go to it one by one, or so many ticks together."""

    def __init__(self, together: int = 0) -> None:
        self.together, self.heard = together, 0
        self.synchronizer, self.receivers = fed_synchronizer()
        self.events: list[tuple[str, int]] = []
        self.sunk: list[tuple[str, bytes, int]] = []
        self.trials: list[Collected] = []
        self.segmenter = TrialSegmenter(
            ("shoulder", "elbow"),
            self.sink,
            self.on_complete,
            lambda status: self.events.append(("begin", status.trial)),
        )

    def sink(self, stamps: Sequence[int], messages: Mapping[str, Sequence[bytes]]) -> None:
        for tick, stamp_ns in enumerate(stamps):
            self.sunk += [(topic, raws[tick], stamp_ns) for topic, raws in messages.items()]

    def on_complete(self, statuses: Sequence[TrialStatus], streams: Streams) -> None:
        self.events.append(("complete", statuses[0].trial))
        before = {t: sum(len(one.messages[t]) for one in self.trials) for t in DATA_STREAMS}
        messages = {
            topic: [raw for name, raw, _ in self.sunk if name == topic][before[topic] :]
            for topic in DATA_STREAMS
        }
        # What went into the bag is what was decoded.
        assert {t: streams.count(t) for t in messages} == {t: len(r) for t, r in messages.items()}
        self.trials.append(Collected(tuple(statuses), messages))

    def feed(
        self, messages: Mapping[str, Sequence[bytes]], statuses: Sequence[TrialStatus], turns: Turns
    ) -> None:
        """Feed so many messages of a stream at each turn, and what is left in the end."""
        data = {topic: iter(messages[topic]) for topic in DATA_STREAMS}
        others = iter(statuses)
        for topic, count in [*turns, *((topic, 10_000) for topic in TOPICS)]:
            for _ in range(count):
                if not (self.feed_status(others) if topic == TRIAL else self.feed_one(topic, data)):
                    break
        self.drain(incomplete=True)

    def drain(self, *, incomplete: bool = False) -> None:
        self.segmenter.add_many(self.synchronizer.take(incomplete=incomplete), self.refuse)

    def refuse(self, topic: str, error: MalformedMessageError) -> None:
        raise error

    def feed_status(self, statuses: Iterator[TrialStatus]) -> bool:
        status = next(statuses, None)
        if status is not None:
            self.drain()
            self.segmenter.add_status(status)
        return status is not None

    def feed_one(self, topic: str, data: Mapping[str, Iterator[bytes]]) -> bool:
        raw = next(data[topic], None)
        if raw is not None and not self.together:
            self.segmenter.add(topic, raw)
        elif raw is not None:
            self.receivers[topic](raw)
            self.heard += topic == PERTURBATION
            if topic == PERTURBATION and self.heard % self.together == 0:
                self.drain()
        return raw is not None

    def assert_orderly(self, trials: int) -> None:
        """Each trial began and was completed once, one after the other, and went to the sink."""
        assert self.events == [
            (what, trial) for trial in range(1, trials + 1) for what in ("begin", "complete")
        ]


def own_messages(recording: SyntheticRecording, number: int) -> Messages:
    first = (number - 1) * LENGTH + SETTLE
    topics = recording.by_topic()
    return {topic: topics[topic][first : first + TICKS] for topic in DATA_STREAMS}


def natural_turns(announced: bool = False) -> list[tuple[str, int]]:
    """The order of the graph, with each status before the command that it concerns.

    Of trials that end early a second status of the perturbation follows the first.
    """
    turns: list[tuple[str, int]] = []
    for tick in range(3 * LENGTH):
        turns += [(JOINT_STATES, 1), (TORQUE_SENSORS, 1)]
        if tick % LENGTH in (0, SETTLE, SETTLE + TICKS):
            turns.append((TRIAL, 1 + (announced and tick % LENGTH == SETTLE)))
        turns += [(COMMANDS, 1), (PERTURBATION, 1)]
    return turns


turns_of_any_kind = st.lists(
    st.tuples(st.sampled_from(TOPICS), st.integers(1, 2 * LENGTH)), max_size=40
)


ticks_together = st.sampled_from([0, 1, 7, 20])


@settings(max_examples=100, deadline=None)
@given(turns=turns_of_any_kind, order=st.permutations(TOPICS), together=ticks_together)
def test_in_every_interleaving_each_trial_has_exactly_its_messages_in_order(
    turns: Turns, order: Sequence[str], together: int
) -> None:
    desk = Desk(together)

    desk.feed(RECORDING.by_topic(), statuses_of(RECORDING), [*turns, *((t, 1000) for t in order)])

    desk.assert_orderly(3)
    for number, trial in enumerate(desk.trials, 1):
        assert trial.messages == own_messages(RECORDING, number)
        phases = [status.phase for status in trial.statuses]
        assert phases[:3] == [Phase.SETTLE, Phase.PERTURB, Phase.REST]
        assert {status.trial for status in trial.statuses} == {number}


def ended_early(*, announced: bool) -> list[TrialStatus]:
    """Statuses of trials that were planned to be twice as long."""
    told: list[TrialStatus] = []
    for status in statuses_of(RECORDING):
        planned = status.phase in (Phase.SETTLE, Phase.PERTURB)
        told.append(replace(status, ticks=2 * TICKS) if planned else status)
        if announced and status.phase is Phase.PERTURB:
            told.append(status)
    return told


@pytest.mark.parametrize("announced", [False, True])
@pytest.mark.parametrize("together", [0, 1, 7, 20])
def test_when_a_trial_ends_early_expect_its_messages_and_no_more_of_what_follows_than_was_there(
    announced: bool, together: int
) -> None:
    desk = Desk(together)

    desk.feed(RECORDING.by_topic(), ended_early(announced=announced), natural_turns(announced))

    desk.assert_orderly(3)
    for number, trial in enumerate(desk.trials, 1):
        for topic, own in own_messages(RECORDING, number).items():
            assert trial.messages[topic][:TICKS] == own
            assert len(trial.messages[topic]) - TICKS <= (0 if announced else max(together, 1))


@pytest.mark.parametrize("together", [1, 50])
def test_ticks_taken_together_are_kept_as_if_they_had_come_one_by_one(together: int) -> None:
    one_by_one, at_once = Desk(), Desk(together)
    for desk in (one_by_one, at_once):
        desk.feed(RECORDING.by_topic(), statuses_of(RECORDING), natural_turns())

    at_once.assert_orderly(3)
    assert at_once.sunk == one_by_one.sunk
    for trial, expected in zip(at_once.trials, one_by_one.trials, strict=True):
        assert (trial.messages, trial.statuses) == (expected.messages, expected.statuses)


def taken_at_once(messages: Mapping[str, Sequence[bytes]]) -> list[int]:
    """Ticks that go to the sink together when all of the first trial come together."""
    ticks: list[int] = []
    segmenter = TrialSegmenter(
        ("shoulder", "elbow"), lambda stamps, _: ticks.append(len(stamps)), lambda *_: None
    )
    for status in statuses_of(RECORDING)[:2]:
        segmenter.add_status(status)
    segmenter.add_many({t: messages[t][SETTLE:LENGTH] for t in DATA_STREAMS}, lambda *_: None)
    return ticks


def test_ticks_of_a_trial_that_are_as_they_should_be_go_on_together() -> None:
    assert taken_at_once(RECORDING.by_topic()) == [TICKS]


def test_when_anything_is_unusual_expect_each_message_looked_at_for_itself() -> None:
    topics = RECORDING.by_topic()
    for topic in STAMPED:
        swapped, longer, foreign = (list(topics[topic]) for _ in range(3))
        swapped[8], swapped[9] = swapped[9], swapped[8]
        longer[8] += b"\0"
        foreign[8] = b"\0\0" + foreign[8][2:]
        for spoilt in (swapped, longer, foreign, topics[topic][1:], [b"\0\1\0\0"] * LENGTH):
            assert set(taken_at_once({**topics, topic: spoilt})) <= {1}
    swapped_everywhere = {**topics}
    for topic in STAMPED:
        swapped_everywhere[topic] = list(topics[topic])
        swapped_everywhere[topic][8:10] = reversed(topics[topic][8:10])
    assert set(taken_at_once(swapped_everywhere)) <= {1}


def test_malformed_messages_among_others_are_refused_by_name() -> None:
    topics = {topic: list(raws) for topic, raws in RECORDING.by_topic().items()}
    topics[TORQUE_SENSORS][SETTLE + 3] = b"\0\1"
    refused: list[str] = []
    desk = Desk()
    for status in statuses_of(RECORDING)[:2]:
        desk.segmenter.add_status(status)

    desk.segmenter.add_many(
        {topic: topics[topic] for topic in DATA_STREAMS},
        lambda topic, error: refused.append(f"{topic}: {error}"),
    )

    (told,) = refused
    assert told.startswith("torque_sensors: message has 2 bytes")
    assert desk.segmenter.streams.count(JOINT_STATES) == TICKS


lost_ticks = st.sets(st.integers(0, 3 * LENGTH - 1), max_size=12)


@settings(max_examples=60, deadline=None)
@given(
    lost=st.fixed_dictionaries(dict.fromkeys(DATA_STREAMS, lost_ticks)),
    order=st.permutations(DATA_STREAMS),
    together=ticks_together,
)
def test_lost_messages_are_missing_and_nothing_else(
    lost: Mapping[str, set[int]], order: Sequence[str], together: int
) -> None:
    desk = Desk(together)
    present = {
        topic: [raw for tick, raw in enumerate(RECORDING.by_topic()[topic]) if tick not in gone]
        for topic, gone in lost.items()
    }
    order_of_arrival = [(topic, 1) for _ in range(LENGTH * 3) for topic in order]

    statuses = statuses_of(RECORDING)
    desk.feed(present, statuses, [(TRIAL, len(statuses)), *order_of_arrival])
    desk.segmenter.finish()

    desk.assert_orderly(3)
    for number, trial in enumerate(desk.trials, 1):
        own = own_messages(RECORDING, number)
        expected = {
            topic: [raw for raw in own[topic] if raw in present[topic]] for topic in STAMPED
        }
        ordinals = [present[PERTURBATION].index(raw) for raw in expected[PERTURBATION]]
        expected[COMMANDS] = [present[COMMANDS][i] for i in ordinals if i < len(present[COMMANDS])]
        last_ns = max(map(stamp_of, expected[PERTURBATION]), default=-1)
        for topic in STAMPED:
            # A sample is known to belong to the trial by a perturbation that is not earlier.
            expected[topic] = [raw for raw in expected[topic] if stamp_of(raw) <= last_ns]
        assert trial.messages == expected


def test_commands_are_paired_with_perturbations_by_their_number_from_the_beginning() -> None:
    topics = RECORDING.by_topic()
    first = SETTLE
    del topics[COMMANDS][0]
    desk = Desk()

    desk.feed(topics, statuses_of(RECORDING), natural_turns())

    assert desk.trials[0].messages[COMMANDS] == topics[COMMANDS][first : first + TICKS]
    assert desk.trials[0].messages[PERTURBATION] == own_messages(RECORDING, 1)[PERTURBATION]


@pytest.mark.parametrize("together", [0, 50])
def test_when_a_stream_falls_silent_expect_the_trial_without_it_once_it_is_overdue(
    together: int,
) -> None:
    recording = synthetic_recording(perturbed=(0, 1), ticks=50, settle=5, rest=2050)
    topics = recording.by_topic()
    del topics[TORQUE_SENSORS][25:]
    desk = Desk(together)
    turns = [(topic, 1) for _ in range(2 * 2105) for topic in DATA_STREAMS]

    desk.feed(topics, statuses_of(recording), [(TRIAL, 10), *turns])

    desk.assert_orderly(2)
    assert [len(trial.messages[TORQUE_SENSORS]) for trial in desk.trials] == [20, 0]
    assert [len(trial.messages[JOINT_STATES]) for trial in desk.trials] == [50, 50]


def test_an_abort_completes_the_trial_with_what_there_is() -> None:
    statuses = statuses_of(RECORDING)
    aborted = replace(statuses[1], phase=Phase.ABORTED, valid=False, reason="a fault")
    desk = Desk()
    topics = RECORDING.by_topic()

    data = {topic: iter(raws) for topic, raws in topics.items()}
    desk.feed_status(iter(statuses[:1]))
    desk.segmenter.add_status(statuses[1])
    for _ in range(SETTLE + 10):
        for topic in DATA_STREAMS:
            desk.feed_one(topic, data)
    desk.segmenter.add_status(aborted)

    desk.assert_orderly(1)
    (trial,) = desk.trials
    assert trial.statuses == (*statuses[:2], aborted)
    assert {topic: len(raws) for topic, raws in trial.messages.items()} == dict.fromkeys(
        DATA_STREAMS, 10
    )
    for _ in range(50):
        for topic in DATA_STREAMS:
            desk.feed_one(topic, data)
    desk.segmenter.finish()
    assert len(desk.trials) == 1


def test_when_aborted_before_the_perturbation_expect_no_trial() -> None:
    statuses = statuses_of(RECORDING)
    desk = Desk()

    desk.feed(
        RECORDING.by_topic(),
        [statuses[0], replace(statuses[0], phase=Phase.ABORTED, valid=False, reason="a fault")],
        [(TRIAL, 2)],
    )
    desk.segmenter.finish()

    assert desk.events == [("begin", 1)]
    assert desk.sunk == []
    assert desk.segmenter.status is None


def test_when_finished_early_expect_what_there_is_and_the_next_trial_whole() -> None:
    desk = Desk()
    topics = RECORDING.by_topic()
    statuses = statuses_of(RECORDING)
    data = {topic: iter(raws) for topic, raws in topics.items()}
    desk.segmenter.add_status(statuses[0])
    desk.segmenter.add_status(statuses[1])
    for _ in range(SETTLE + 7):
        for topic in DATA_STREAMS:
            desk.feed_one(topic, data)

    desk.segmenter.finish()
    desk.segmenter.finish()
    assert [len(raws) for raws in desk.trials[0].messages.values()] == [7] * 4

    desk.feed({topic: list(rest) for topic, rest in data.items()}, statuses[3:6], [(TRIAL, 3)])
    assert desk.events == [("begin", 1), ("complete", 1), ("begin", 2), ("complete", 2)]
    assert desk.trials[1].messages == own_messages(RECORDING, 2)


@pytest.mark.parametrize("drift", [-1e-4, 1e-4])
def test_clock_of_a_driver_may_drift(drift: float) -> None:
    ticks = 5000
    stamps = [round(k * PERIOD_NS * (1 + drift)) for k in range(ticks + 20)]
    states, efforts = (JointStateEncoder(("a",), field) for field in ("position", "effort"))
    topics = {
        JOINT_STATES: [states.encode(stamp_ns, (0.0,)) for stamp_ns in stamps],
        TORQUE_SENSORS: [efforts.encode(stamp_ns, (0.0,)) for stamp_ns in stamps],
        COMMANDS: [CommandEncoder(1).encode((0.0,))] * len(stamps),
        PERTURBATION: [efforts.encode(stamp_ns, (1.0,)) for stamp_ns in stamps],
    }
    settle, perturb, rest = statuses_of(RECORDING)[:3]
    statuses = [settle, *(replace(s, start_ns=0, ticks=ticks) for s in (perturb, rest))]
    desk = Desk()
    turns = [(topic, 1) for _ in stamps for topic in DATA_STREAMS]

    desk.feed(topics, statuses, [(TRIAL, 3), *turns])

    desk.assert_orderly(1)
    for topic, raws in desk.trials[0].messages.items():
        assert raws == topics[topic][:ticks]


def fed_in_turn(spoil: Mapping[str, list[bytes]]) -> list[Collected]:
    """Trials of a graph that sends one message of each stream after the other."""
    messages = {**RECORDING.by_topic(), **spoil}
    statuses = statuses_of(RECORDING)
    desk = Desk()
    desk.segmenter.add_status(statuses[0])
    desk.segmenter.add_status(statuses[1])
    desk.feed(messages, statuses[2:], [(topic, 1) for _ in range(3 * LENGTH) for topic in TOPICS])
    return desk.trials


@pytest.mark.parametrize("topic", [JOINT_STATES, TORQUE_SENSORS])
@pytest.mark.parametrize("tick", [0, 5, TICKS - 2])
def test_samples_out_of_order_are_kept_in_the_order_of_their_arrival(topic: str, tick: int) -> None:
    stream = list(RECORDING.by_topic()[topic])
    i = SETTLE + tick
    stream[i], stream[i + 1] = stream[i + 1], stream[i]

    first = fed_in_turn({topic: stream})[0].messages[topic]

    assert first == stream[SETTLE : SETTLE + TICKS]


def test_a_stamp_far_in_the_future_holds_nothing_up() -> None:
    stream = list(RECORDING.by_topic()[JOINT_STATES])
    wrong = JointStateEncoder(("shoulder", "elbow"), "position").encode(10**15, (0.0, 0.0))
    stream.insert(SETTLE + 5, wrong)

    first = fed_in_turn({JOINT_STATES: stream})[0].messages[JOINT_STATES]

    assert first == RECORDING.by_topic()[JOINT_STATES][SETTLE : SETTLE + TICKS]


@pytest.mark.parametrize("stray", [0, SETTLE])
def test_a_perturbation_of_somebody_else_between_trials_displaces_no_command(stray: int) -> None:
    stream = list(RECORDING.by_topic()[PERTURBATION])
    stream.insert(SETTLE + TICKS + 1, stream[stray])

    spoiled, sound = fed_in_turn({PERTURBATION: stream}), fed_in_turn({})

    assert len(sound) > 1
    assert [one.messages for one in spoiled] == [one.messages for one in sound]
