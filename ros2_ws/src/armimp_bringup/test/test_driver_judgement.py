"""Judgement of drivers: what is sound passes, and each planted defect is named."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import (
    SENSOR_TOPICS,
    Call,
    Ending,
    Endpoint,
    Message,
    Moves,
    Outcome,
    Record,
)
from armimp_bringup.driver_check.checker import Checker
from armimp_bringup.driver_check.conversation import Answering, Error, MotionGuard, Torque
from armimp_bringup.driver_check.rules import judge
from armimp_common import topics
from armimp_common.cdr import JointStateEncoder
from armimp_common.topics import (
    COMMANDS,
    JOINT_STATES,
    NS_PER_S,
    PERIOD_NS,
    SIM_STOP_SERVICE,
    TORQUE_SENSORS,
    VALUE_FIELD,
)
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig

JOINTS = ("shoulder", "elbow")
ZERO = (0.0, 0.0)
SAMPLES = 1000
PATIENCE = 5
Edit = Callable[[Message], Mapping[str, Any]]
"""Fields of a message that are changed, with their new values."""


class Driver(Answering):
    """A driver in real time and the checker that tests it, on one clock; sound but for defects."""

    watchdog = True
    """Whether it stops without commands."""
    lets_go = True
    """Whether it then takes the torque away."""
    latches = True
    """Whether it waits for a reset."""
    resets = True
    """Whether it grants a reset."""
    deaf = False
    """Whether it acknowledges an emergency stop without stopping."""
    moody = False
    answers_after = tells_after = 0.0
    """How long it takes to acknowledge an emergency stop, and to tell of a fault (s)."""
    sign = 1.0
    """Sign of its transducers."""

    def __init__(self, **defects: Any) -> None:
        self.time_ns, self.tick = NS_PER_S, 0
        super().__init__(JOINTS)
        self.rig = SimulatedRig(SimulatorParameters.preset().model_copy(update={"substeps": 20}))
        self.encoders = {
            topic: JointStateEncoder(JOINTS, VALUE_FIELD[topic]) for topic in SENSOR_TOPICS
        }
        self.tells: list[Error] = []
        self.commanded: Torque = ZERO
        self.silent = -1
        self.told_to_stop: float = math.inf
        """Tick of the stop."""
        self.waiting: list[tuple[str, bytes]] = []
        for name, defect in defects.items():
            setattr(self, name, defect)

    @property
    def errors(self) -> list[Error]:
        """What it has told of faults so far."""
        return [one for one in self.tells if one.when <= self.now()]

    def held_up(self, tick: int) -> bool:
        """Whether nothing that it sends reaches the checker."""
        return False

    def drive(self, torque: Torque) -> Torque:
        """Torque that the drives make of a commanded one."""
        return torque

    def now_ns(self) -> int:
        return self.time_ns

    def command(self, torque: Torque) -> None:
        self.silent, self.commanded = 0, torque
        if not self.latches:
            self.rig.fault = ""

    def latch(self, fault: str) -> None:
        if not self.rig.fault:
            self.tells.append(Error(self.now() + self.tells_after, "arm_sim: rig", fault))
        if self.lets_go:
            self.rig.fade(fault)
        else:
            self.rig.fault = fault

    def step(self) -> None:
        self.time_ns += PERIOD_NS
        self.tick += 1
        if self.silent >= 0:
            self.silent += 1
        if self.watchdog and self.silent > PATIENCE:
            self.latch("no command")
        if self.moody and self.tick > 3000:
            self.latch("the mood")
        self.rig.step(self.drive(self.commanded))
        for topic, values in (
            (JOINT_STATES, self.rig.position),
            (TORQUE_SENSORS, self.sign * self.rig.torque),
        ):
            self.waiting.append((topic, self.encoders[topic].encode(self.time_ns, values)))
        if not self.held_up(self.tick):
            arrived, self.waiting = self.waiting, []
            for topic, data in arrived:
                self.hear(topic, data)

    def wait(self, condition: Callable[[], bool], patience: float) -> bool:
        end = self.now() + patience
        while not condition() and self.now() < end:
            self.step()
        return condition()

    def call(self, service: str, patience: float, since: float | None = None) -> Call:
        self.step()
        if service == SIM_STOP_SERVICE:
            self.told_to_stop = self.tick
            if not self.deaf:
                self.latch("emergency stop")
            return Call(success=True, seconds=self.answers_after)
        if self.commanded != ZERO or not self.resets:
            return Call(success=False, message="there is torque")
        self.rig.reset()
        return Call(success=True)

    @contextmanager
    def intruder(self, patience: float) -> Iterator[None]:
        self.step()
        self.latch("second publisher")
        yield


def messages(topic: str, edit: Edit = lambda _: {}) -> list[Message]:
    """A second of a sound stream, with readings that change by a count now and then."""
    rng = np.random.default_rng(7)
    step = 2.0 * np.pi / 51200 if topic == JOINT_STATES else 0.02
    centre = (1.09, 1.35) if topic == JOINT_STATES else (0.0, 0.0)
    found = []
    for tick in range(SAMPLES):
        counts = np.rint(np.array(centre) / step) + rng.integers(-1, 2, 2)
        values = tuple((counts * step).tolist())
        message = Message(
            arrival_ns=10**12 + tick * PERIOD_NS + int(rng.integers(0, 50_000)),
            stamp_ns=tick * PERIOD_NS,
            names=JOINTS,
            position=values if topic == JOINT_STATES else (),
            effort=values if topic == TORQUE_SENSORS else (),
        )
        found.append(message._replace(**edit(message)))
    return found


def endpoint(topic: str, role: Literal["publisher", "subscriber"]) -> Endpoint:
    return Endpoint(topic, role, "/arm_sim", topics.TOPICS[topic].type)


def moved(driver: Driver) -> Record:
    """Let the checker move a driver that is sound at rest."""
    checker: Any = driver
    # As in real time, every sample from the activation on is answered.
    driver.torque = ZERO
    moves = Checker(checker, CheckOptions(joints=JOINTS, move=True)).move()
    return Record(
        joints=JOINTS,
        endpoints=[
            *(endpoint(topic, "publisher") for topic in SENSOR_TOPICS),
            endpoint(COMMANDS, "subscriber"),
        ],
        streams={topic: messages(topic) for topic in SENSOR_TOPICS},
        moving={topic: [one for one in kept if one] for topic, kept in driver.kept.items()},
        services=frozenset({topics.SIM_STOP_SERVICE, topics.SIM_RESET_SERVICE}),
        lifecycle="unconfigured",
        most=0.3,
        moves=moves,
    )


@pytest.fixture(scope="module")
def sound() -> Record:
    return moved(Driver())


def edited(record: Record, topic: str, edit: Edit) -> Record:
    return replace(record, streams={**record.streams, topic: messages(topic, edit)})


def failed(record: Record) -> list[str]:
    return [one.check for one in judge(record) if one.outcome is Outcome.FAIL]


def unsure(record: Record) -> set[str]:
    return {one.check for one in judge(record) if one.outcome is Outcome.INCONCLUSIVE}


def test_a_sound_driver_passes(sound: Record) -> None:
    assert [one for one in judge(sound) if one.outcome is not Outcome.PASS] == []


def after(message: Message) -> bool:
    """Whether a tenth of a second is over."""
    return message.stamp_ns > 10**8


@pytest.mark.parametrize(
    ("topic", "edit", "named"),
    [
        (JOINT_STATES, lambda _: {"names": ("shoulder", "wrist")}, "joint names"),
        (JOINT_STATES, lambda _: {"names": ("elbow", "elbow")}, "joint names"),
        (JOINT_STATES, lambda m: {"position": tuple(map(math.degrees, m.position))}, "range"),
        (JOINT_STATES, lambda m: {"position": m.position[:1]}, "field"),
        # The counter of the encoder wraps.
        (JOINT_STATES, lambda m: {"position": (m.position[0] - 6.3 * after(m), 1.0)}, "jumps"),
        (TORQUE_SENSORS, lambda m: {"position": m.effort, "effort": ()}, "field"),
        (TORQUE_SENSORS, lambda m: {"effort": tuple(1e3 * v + 600 for v in m.effort)}, "range"),
        (
            TORQUE_SENSORS,
            lambda m: {"effort": (math.nan, 0.0)} if m.stamp_ns == 10**8 else {},
            "finite",
        ),
        (JOINT_STATES, lambda _: {"stamp_ns": 0}, "stamps increase"),
        (
            JOINT_STATES,
            lambda m: {"stamp_ns": m.stamp_ns - 2 * PERIOD_NS * after(m)},
            "stamps increase",
        ),
        (JOINT_STATES, lambda m: {"stamp_ns": m.stamp_ns * 1001 // 1000}, "clock"),
    ],
)
def test_each_defect_of_a_stream_is_named(
    sound: Record, topic: str, edit: Edit, named: str
) -> None:
    assert f"{topic}: {named}" in failed(edited(sound, topic, edit))


def test_when_samples_come_at_half_the_rate_expect_rate_and_stamps_named(sound: Record) -> None:
    slow = {topic: kept[::2] for topic, kept in sound.streams.items()}
    names = failed(replace(sound, streams=slow))
    for topic in SENSOR_TOPICS:
        assert {f"{topic}: rate", f"{topic}: stamps 1 ms apart", f"{topic}: clock"} <= set(names)


def held_up(message: Message) -> Mapping[str, Any]:
    late = message.stamp_ns // PERIOD_NS % 20 == 3
    return {"arrival_ns": message.arrival_ns + 600_000 * late}


def slower(share: float) -> Edit:
    """Stretch the arrivals of a stream by this factor, so that it is slower by the wall clock."""
    start = 10**12
    return lambda m: {"arrival_ns": start + round(share * (m.arrival_ns - start))}


@pytest.mark.parametrize(
    ("topic", "edit", "named", "doubtful"),
    [
        (TORQUE_SENSORS, lambda m: {"stamp_ns": m.stamp_ns + 1000}, ["pairs"], []),
        (JOINT_STATES, lambda m: {"names": JOINTS[::-1], "position": m.position[::-1]}, [], []),
        # The jitter may be the driver's, or that of a busy machine.
        (JOINT_STATES, held_up, [], [f"{JOINT_STATES}: jitter"]),
        (JOINT_STATES, slower(1.003), [], []),
        (JOINT_STATES, slower(1.015), [f"{JOINT_STATES}: rate"], []),
    ],
    ids=["stamps of a pair differ", "another order", "jitter", "hardly slower", "slower"],
)
def test_a_peculiarity_of_a_stream_is_named_only_if_it_is_a_defect(
    sound: Record, topic: str, edit: Edit, named: list[str], doubtful: list[str]
) -> None:
    record = edited(sound, topic, edit)
    assert failed(record) == named
    assert unsure(record) == set(doubtful)


def test_missing_topics_and_wrong_types_or_qualities_of_service_are_named(sound: Record) -> None:
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


def test_services_that_are_missing_or_silent_and_a_second_publisher_are_named(
    sound: Record,
) -> None:
    silent, borne = Ending(stop=Call(success=None)), Ending(reset=Call(success=True))
    moves = replace(sound.moves, stop=silent, second=borne)
    assert failed(replace(sound, moves=moves, services=frozenset())) == [
        f"service {topics.SIM_STOP_SERVICE}",
        f"service {topics.SIM_RESET_SERVICE}",
        "emergency stop: answer",
        REPORTED[2],
    ]


def test_a_fault_at_rest_is_named_and_what_was_asked_for_in_vain_is_inconclusive(
    sound: Record,
) -> None:
    fault = "arm_sim: rig: emergency stop"
    refused = Moves(missing=f"there was a fault before: {fault}")
    record = replace(sound, faults=[fault], moves=refused)
    assert failed(record) == ["no fault at rest"]
    assert "torque: delay" in unsure(record)
    # Without --move nothing was asked for.
    assert unsure(replace(record, moves=Moves())) == set()


def late(by: int) -> Callable[[Torque], Torque]:
    """Drives that apply every command so many periods late."""
    waiting: list[Torque] = [ZERO] * by

    def drive(torque: Torque) -> Torque:
        waiting.append(torque)
        return waiting.pop(0)

    return drive


MIXED, SIGN = "torque: joint and sign", "torque_sensors: sign"
REPORTED = [f"{of}: reported" for of in ("stale commands", "emergency stop", "second publisher")]
NEVER = [REPORTED[0], "stale commands: torque", "stale commands: latched"]
KEPT, LATCHED = "emergency stop: torque", "emergency stop: latched"


@pytest.mark.parametrize(
    ("defects", "expected", "words"),
    [
        ({"watchdog": False}, NEVER, ""),
        ({"lets_go": False}, ["stale commands: torque", KEPT], ""),
        ({"latches": False}, ["stale commands: latched", KEPT, LATCHED], ""),
        ({"deaf": True}, [REPORTED[1], KEPT, LATCHED], ""),
        ({"deaf": True, "watchdog": False}, [*NEVER, REPORTED[1], KEPT, LATCHED], ""),
        (
            {"resets": False},
            [
                *("stale commands: reset", REPORTED[1], KEPT, "emergency stop: reset"),
                *(REPORTED[2], "second publisher: reset"),
            ],
            "",
        ),
        ({"drive": late(6)}, ["torque: delay"], ""),
        ({"drive": lambda t: (-t[0], t[1])}, [MIXED], "shoulder turns against"),
        ({"drive": lambda t: (t[1], t[0])}, [MIXED], "shoulder and elbow mixed up"),
        ({"drive": lambda t: (-t[0], -t[1])}, [MIXED], "shoulder turns against"),
        ({"drive": lambda t: (-t[0], -t[1]), "sign": -1.0}, [MIXED, SIGN], "elbow turns against"),
        ({"sign": -1.0}, [SIGN], "shoulder +"),
        ({"answers_after": 0.4, "tells_after": 1.4}, [], ""),
        ({"answers_after": 0.6}, ["emergency stop: answer"], ""),
        ({"tells_after": 1.6}, REPORTED, ""),
    ],
)
def test_each_defect_of_a_driver_under_torque_is_named_and_nothing_else(
    defects: Any, expected: list[str], words: str
) -> None:
    record = moved(Driver(**defects))
    assert record.moves.missing == ""
    assert failed(record) == expected
    assert MIXED in expected or not unsure(record)
    assert words in {one.check: one.figure for one in judge(record)}[MIXED]


def test_when_the_watchdog_of_a_deaf_driver_speaks_after_the_stop_expect_its_torque_named() -> None:
    driver: Driver = Driver(deaf=True, held_up=lambda tick: 300 < tick - driver.told_to_stop < 310)
    record = moved(driver)
    assert record.moves.stop is not None
    assert record.moves.stop.reported == pytest.approx(0.306, abs=0.005)
    assert failed(record) == [KEPT]


def test_nothing_is_judged_by_motion_where_nothing_moved(sound: Record) -> None:
    still = [
        push._replace(moved=0 * push.moved, delay=None, change=0.0) for push in sound.moves.pushes
    ]
    record = replace(sound, moves=replace(sound.moves, pushes=still))
    assert {MIXED, SIGN, "torque: delay"} <= unsure(record)


def test_when_commands_are_held_up_and_the_driver_stops_expect_no_judgement() -> None:
    record = moved(Driver(held_up=lambda tick: tick in range(1500, 1510)))
    assert record.moves.missing.startswith("the driver stopped: arm_sim: rig: no command")
    assert 0.009 < record.moves.gap < 0.012
    assert failed(record) == []
    assert unsure(record) >= {*REPORTED, "torque: no stop"}


@pytest.mark.parametrize(
    ("defects", "named", "fault"),
    [
        ({"moody": True}, "torque: no stop", ""),
        # The driver is told to stop, and is not reset.
        ({"drive": lambda t: (20.0 * t[0], 20.0 * t[1])}, "torque: motion", "emergency stop"),
    ],
)
def test_a_driver_that_stops_by_itself_or_goes_astray_is_named_and_the_rest_is_inconclusive(
    defects: Any, named: str, fault: str
) -> None:
    driver = Driver(**defects)
    record = moved(driver)
    assert failed(record) == [named]
    assert unsure(record) >= set(REPORTED[1:])
    assert driver.rig.fault == fault


def angles(*values: float, names: tuple[str, ...] = JOINTS) -> Message:
    return Message(0, 0, names, values, ())


@pytest.fixture
def guard() -> MotionGuard:
    guard = MotionGuard(("shoulder", "elbow"), 0.3)
    assert guard.allows(angles(1.0, -2.0))
    return guard


def test_motion_within_the_limit_is_allowed_and_the_largest_kept(guard: MotionGuard) -> None:
    assert guard.allows(angles(1.1, -2.25))
    assert guard.allows(angles(1.0, -2.0))
    assert guard.largest == pytest.approx(0.25)
    assert not guard.objection


@pytest.mark.parametrize(
    ("message", "objection"),
    [
        *(
            (angles(*values), "rad from where it was: torque taken away")
            for values in ((1.31, -2.0), (1.0, -2.4), (math.nan, -2.0), (1.0, math.inf))
        ),
        (None, "the angles cannot be read: torque taken away"),
        (angles(1.0, -2.0, names=("shoulder", "wrist")), "the angles cannot be read"),
    ],
)
def test_beyond_the_limit_or_at_unknown_angles_the_torque_is_taken_away_for_good(
    guard: MotionGuard, message: Message | None, objection: str
) -> None:
    assert not guard.allows(message)
    assert objection in guard.objection
    # Coming back is no excuse.
    assert not guard.allows(angles(1.0, -2.0))
