"""Judgement of drivers: what is sound passes, and each planted defect is named."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest

from armimp_bringup.driver_check import (
    Call,
    Ending,
    Endpoint,
    Message,
    Moves,
    Outcome,
    Push,
    Record,
    measure,
    with_outcome,
)
from armimp_bringup.driver_check.rules import judge
from armimp_common import topics
from armimp_common.topics import COMMANDS, JOINT_STATES, PERIOD_NS, TORQUE_SENSORS
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig

JOINTS = ("shoulder", "elbow")
ZERO = (0.0, 0.0)
SAMPLES, REST, HOLD = 1000, 200, 400
TOPICS = (JOINT_STATES, TORQUE_SENSORS)
Torque = tuple[float, float]
Edit = Callable[[Message], Message]


class Bench:
    """The simulated rig, with commands and readings as a bad driver would pass them on."""

    def __init__(self, drive: Callable[[Torque], Torque] = lambda torque: torque) -> None:
        self.rig = SimulatedRig(SimulatorParameters.preset())
        self.drive = drive

    def play(self, script: list[Torque]) -> list[list[np.ndarray]]:
        """Readings before each command."""
        rows = []
        for torque in script:
            rows.append([self.rig.position.copy(), self.rig.torque.copy()])
            self.rig.step(self.drive(torque))
        return rows

    def push(self, joint: int, sign: float = 1.0, share: float = 1.0) -> Push:
        """Let the arm settle, and push a joint; `share` of the torque acts."""
        torque = (share, 0.0) if joint == 0 else (0.0, share)
        self.play([ZERO] * 1500)
        rows = self.play([ZERO] * REST + [torque] * HOLD + [ZERO] * 100)
        position, effort = (np.array([row[kind] for row in rows]).T for kind in (0, 1))
        return measure(joint, 1.0, position, sign * effort, REST, REST + HOLD)

    def pushes(self, sign: float = 1.0) -> list[Push]:
        return [self.push(joint, sign) for joint in range(2)]


def messages(topic: str, edit: Edit = lambda message: message) -> list[Message]:
    """A second of a sound stream, with readings that change by a count now and then."""
    rng = np.random.default_rng(7)
    step = 2.0 * np.pi / 51200 if topic == JOINT_STATES else 0.02
    centre = (1.09, 1.35) if topic == JOINT_STATES else (0.0, 0.0)
    found = []
    for tick in range(SAMPLES):
        counts = np.rint(np.array(centre) / step) + rng.integers(-1, 2, 2)
        values = tuple((counts * step).tolist())
        found.append(
            edit(
                Message(
                    arrival_ns=10**12 + tick * PERIOD_NS + int(rng.integers(0, 50_000)),
                    stamp_ns=tick * PERIOD_NS,
                    names=JOINTS,
                    position=values if topic == JOINT_STATES else (),
                    effort=values if topic == TORQUE_SENSORS else (),
                )
            )
        )
    return found


GRANTED = Call(success=True, seconds=0.01)


def endpoint(topic: str, role: Literal["publisher", "subscriber"]) -> Endpoint:
    return Endpoint(topic, role, "/arm_sim", topics.MESSAGE_TYPES[topic])


@pytest.fixture(scope="module")
def sound() -> Record:
    bench = Bench()
    pushes = bench.pushes()
    again = bench.push(0, share=0.0)
    return Record(
        joints=JOINTS,
        paced=True,
        endpoints=[
            *(endpoint(topic, "publisher") for topic in TOPICS),
            endpoint(COMMANDS, "subscriber"),
        ],
        streams={topic: messages(topic) for topic in TOPICS},
        services=frozenset({topics.SIM_STOP_SERVICE, topics.SIM_RESET_SERVICE}),
        lifecycle="unconfigured",
        most=0.3,
        moves=Moves(
            pushes=pushes,
            moved=0.002,
            stale=Ending(told=0.02, reset=GRANTED, ended=pushes[0], again=again),
            stop=Ending(told=0.02, reset=GRANTED, again=again, stop=GRANTED),
            second=Ending(told=0.02, reset=GRANTED),
        ),
    )


def edited(record: Record, topic: str, edit: Edit) -> Record:
    return replace(record, streams={**record.streams, topic: messages(topic, edit)})


def moved(record: Record, **changes: Any) -> Record:
    return replace(record, moves=replace(record.moves, **changes))


def failed(record: Record) -> list[str]:
    return with_outcome(judge(record), Outcome.FAIL)


def unsure(record: Record) -> set[str]:
    return set(with_outcome(judge(record), Outcome.INCONCLUSIVE))


def test_a_sound_driver_passes(sound: Record) -> None:
    findings = judge(sound)
    assert with_outcome(findings, Outcome.FAIL) == []
    assert with_outcome(findings, Outcome.NOT_CHECKED) == []
    assert with_outcome(findings, Outcome.INCONCLUSIVE) == []


@pytest.mark.parametrize(
    ("topic", "edit", "named"),
    [
        (JOINT_STATES, lambda m: m._replace(names=("shoulder", "wrist")), "joint names"),
        (JOINT_STATES, lambda m: m._replace(names=("elbow", "elbow")), "joint names"),
        (
            JOINT_STATES,
            lambda m: m._replace(position=tuple(np.degrees(m.position).tolist())),
            "range",
        ),
        (JOINT_STATES, lambda m: m._replace(position=m.position[:1]), "field"),
        # The counter of the encoder wraps.
        (
            JOINT_STATES,
            lambda m: m._replace(position=(m.position[0] - 6.3 * (m.stamp_ns > 10**8), 1.0)),
            "jumps",
        ),
        (TORQUE_SENSORS, lambda m: m._replace(position=m.effort, effort=()), "field"),
        (
            TORQUE_SENSORS,
            lambda m: m._replace(effort=tuple(1e3 * v + 600.0 for v in m.effort)),
            "range",
        ),
        (
            TORQUE_SENSORS,
            lambda m: m._replace(effort=(float("nan"), 0.0)) if m.stamp_ns == 10**8 else m,
            "finite",
        ),
        (JOINT_STATES, lambda m: m._replace(stamp_ns=0), "stamps increase"),
        (
            JOINT_STATES,
            lambda m: m._replace(stamp_ns=m.stamp_ns - 2 * PERIOD_NS * (m.stamp_ns > 10**8)),
            "stamps increase",
        ),
        (JOINT_STATES, lambda m: m._replace(stamp_ns=m.stamp_ns * 1001 // 1000), "clock"),
    ],
)
def test_each_defect_of_a_stream_is_named(
    sound: Record, topic: str, edit: Edit, named: str
) -> None:
    assert f"{topic}: {named}" in failed(edited(sound, topic, edit))


def test_when_samples_come_at_half_the_rate_expect_rate_and_stamps_named(sound: Record) -> None:
    slow = {topic: kept[::2] for topic, kept in sound.streams.items()}
    names = failed(replace(sound, streams=slow))
    for topic in TOPICS:
        assert {f"{topic}: rate", f"{topic}: stamps 1 ms apart", f"{topic}: clock"} <= set(names)


def held_up(message: Message) -> Message:
    late = message.stamp_ns // PERIOD_NS % 20 == 3
    return message._replace(arrival_ns=message.arrival_ns + 600_000 * late)


def slower(share: float) -> Edit:
    """A stream that is slower by the wall clock."""
    start = 10**12
    return lambda m: m._replace(arrival_ns=start + round(share * (m.arrival_ns - start)))


@pytest.mark.parametrize(
    ("topic", "edit", "named", "doubtful"),
    [
        (TORQUE_SENSORS, lambda m: m._replace(stamp_ns=m.stamp_ns + 1000), ["pairs"], []),
        (
            JOINT_STATES,
            lambda m: m._replace(names=m.names[::-1], position=m.position[::-1]),
            [],
            [],
        ),
        # It may be the driver's, or that of a busy machine.
        (JOINT_STATES, held_up, [], [f"{JOINT_STATES}: jitter"]),
        (JOINT_STATES, slower(1.003), [], []),
        (JOINT_STATES, slower(1.015), [f"{JOINT_STATES}: rate"], []),
    ],
    ids=["stamps of a pair differ", "another order", "jitter", "hardly slower", "slower"],
)
def test_what_is_odd_about_a_stream_is_named_alone_if_it_is_a_defect(
    sound: Record, topic: str, edit: Edit, named: list[str], doubtful: list[str]
) -> None:
    record = edited(sound, topic, edit)
    assert failed(record) == named
    assert unsure(record) == set(doubtful)


def test_what_is_missing_or_of_another_kind_is_named(sound: Record) -> None:
    ends = {end.topic: end for end in sound.endpoints}
    ends[JOINT_STATES] = ends[JOINT_STATES]._replace(type="std_msgs/msg/Float64MultiArray")
    ends[TORQUE_SENSORS] = ends[TORQUE_SENSORS]._replace(reliable=False)
    assert failed(replace(sound, endpoints=list(ends.values()))) == [
        f"{JOINT_STATES}: type",
        f"{TORQUE_SENSORS}: quality of service",
    ]
    del ends[TORQUE_SENSORS], ends[JOINT_STATES]
    streams = {JOINT_STATES: sound.streams[JOINT_STATES]}
    assert failed(replace(sound, endpoints=list(ends.values()), streams=streams)) == [
        f"{JOINT_STATES}: type",
        f"{TORQUE_SENSORS}: type",
        f"{TORQUE_SENSORS}: messages",
        "pairs",
    ]


@pytest.mark.parametrize(
    ("drive", "sign", "named", "words"),
    [
        (lambda t: (-t[0], t[1]), 1.0, ["torque: joint and sign"], "shoulder turns against"),
        (lambda t: (t[1], t[0]), 1.0, ["torque: joint and sign"], "shoulder and elbow mixed up"),
        (lambda t: (-t[0], -t[1]), 1.0, ["torque: joint and sign"], "shoulder turns against"),
        (
            lambda t: (-t[0], -t[1]),
            -1.0,
            ["torque: joint and sign", "torque_sensors: sign"],
            "elbow turns against",
        ),
        (lambda t: t, -1.0, ["torque_sensors: sign"], "shoulder +"),
    ],
)
def test_wrong_signs_and_orders_are_told_apart(
    sound: Record,
    drive: Callable[[Torque], Torque],
    sign: float,
    named: list[str],
    words: str,
) -> None:
    pushes, stale = Bench(drive).pushes(sign), sound.moves.stale
    assert stale is not None
    record = moved(sound, pushes=pushes, stale=stale._replace(ended=pushes[0]))
    assert failed(record) == named
    figures = {one.check: one.figure for one in judge(record)}
    assert words in figures["torque: joint and sign"]


def test_services_that_are_missing_or_silent_and_a_second_publisher_are_named(
    sound: Record,
) -> None:
    silent = Ending(stop=Call(success=None))
    borne = Ending(reset=GRANTED)
    assert failed(replace(moved(sound, stop=silent, second=borne), services=frozenset())) == [
        f"service {topics.SIM_STOP_SERVICE}",
        f"service {topics.SIM_RESET_SERVICE}",
        "emergency stop: answer",
        "second publisher: told",
    ]


def test_a_driver_on_whose_way_six_commands_always_are_is_late(sound: Record) -> None:
    waiting = [ZERO] * 6

    def late(torque: Torque) -> Torque:
        waiting.append(torque)
        return waiting.pop(0)

    assert failed(moved(sound, pushes=Bench(late).pushes())) == ["torque: delay"]


def test_nothing_is_judged_by_motion_where_nothing_moved(sound: Record) -> None:
    still = [
        push._replace(moved=0 * push.moved, delay=None, change=0.0) for push in sound.moves.pushes
    ]
    assert {"torque: joint and sign", "torque_sensors: sign", "torque: delay"} <= unsure(
        moved(sound, pushes=still)
    )


def test_when_torque_acts_again_before_the_reset_expect_that_named_alone(sound: Record) -> None:
    again = Bench().push(0)
    assert sound.moves.stale is not None
    assert sound.moves.stop is not None
    stale, stop = sound.moves.stale._replace(again=again), sound.moves.stop._replace(again=again)
    assert failed(moved(sound, stale=stale)) == ["stale commands: latched"]
    assert failed(moved(sound, stop=stop)) == ["emergency stop: latched"]


@pytest.mark.parametrize(
    ("told", "named"),
    [
        ({"missing": "elbow went 0.31 rad", "astray": True}, ["torque: motion"]),
        ({"missing": "the driver stopped", "fault": "arm_sim: no"}, ["torque: no stop"]),
        # The machine held commands up: no judgement of the driver.
        ({"missing": "the driver stopped", "fault": "arm_sim: no", "gap": 0.012}, []),
    ],
)
def test_why_moves_were_given_up_is_named_and_the_rest_is_inconclusive(
    sound: Record, told: Any, named: list[str]
) -> None:
    record = replace(sound, moves=Moves(moved=0.002, **told))
    assert failed(record) == named
    left = {"torque: joint and sign", "torque: delay", "stale commands: told"}
    assert left <= unsure(record)


def test_a_fault_at_rest_is_named_and_what_was_asked_for_in_vain_is_inconclusive(
    sound: Record,
) -> None:
    fault = "arm_sim: rig: emergency stop"
    refused = Moves(missing=f"there was a fault before: {fault}")
    record = replace(sound, faults=[fault], moves=refused)
    assert failed(record) == ["no fault at rest"]
    assert "torque: delay" in unsure(record)
    # Without --move nothing was asked for.
    assert unsure(replace(record, moves=Moves(asked=False, missing="not asked"))) == set()
