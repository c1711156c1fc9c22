"""What the checker does with torque in real time, on a clock that is counted, and its limit."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import (
    SENSOR_TOPICS,
    Call,
    Finding,
    Message,
    Moves,
    Outcome,
    Record,
    with_outcome,
)
from armimp_bringup.driver_check.checker import Checker
from armimp_bringup.driver_check.conversation import Answering, Error, MotionGuard, Torque
from armimp_bringup.driver_check.rules import judge
from armimp_common.cdr import JointStateEncoder
from armimp_common.topics import (
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
PATIENCE, RAMP = 5, 10


class Driver(Answering):
    """A driver in real time and the checker in front of it, on one clock.

    `watchdog` tells whether it stops without commands, `lets_go` whether torque then goes, and
    `latches` whether it waits for a reset. While the checker is `held_up`, nothing that the driver
    sends reaches it.
    """

    def __init__(
        self,
        *,
        watchdog: bool = True,
        lets_go: bool = True,
        latches: bool = True,
        held_up: Callable[[int], bool] = lambda _: False,
        moody: bool = False,
    ) -> None:
        self.time_ns, self.tick = NS_PER_S, 0
        super().__init__(JOINTS, self.obey, now_ns=lambda: self.time_ns, sleep=lambda _: None)
        self.rig = SimulatedRig(SimulatorParameters.preset())
        self.watchdog, self.lets_go, self.latches = watchdog, lets_go, latches
        self.held_up, self.moody = held_up, moody
        self.encoders = {
            topic: JointStateEncoder(JOINTS, field)
            for topic, field in VALUE_FIELD.items()
            if topic in SENSOR_TOPICS
        }
        self.errors: list[Error] = []
        self.commanded: Torque = ZERO
        self.applied: Torque = ZERO
        self.fault, self.silent, self.fading = "", -1, 0
        self.waiting: list[tuple[str, bytes]] = []

    def obey(self, torque: Torque) -> None:
        self.silent, self.commanded = 0, torque
        if self.fault == "no command" and not self.latches:
            self.fault = ""

    def latch(self, fault: str) -> None:
        if not self.fault:
            self.fault, self.fading = fault, RAMP
            self.errors.append(Error(self.now(), "arm_sim: rig", fault))

    def step(self) -> None:
        self.time_ns += PERIOD_NS
        self.tick += 1
        if self.silent >= 0:
            self.silent += 1
        if self.watchdog and self.silent > PATIENCE:
            self.latch("no command")
        if self.moody and self.tick > 3000:
            self.latch("the mood")
        if self.fault and self.lets_go:
            self.fading = max(self.fading - 1, 0)
            share = self.fading / RAMP
            self.applied = (share * self.applied[0], share * self.applied[1])
        elif not self.fault:
            self.applied = self.commanded
        self.rig.step(self.applied)
        for topic, values in (
            (JOINT_STATES, self.rig.position),
            (TORQUE_SENSORS, self.rig.torque),
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
            self.latch("emergency stop")
            return Call(success=True)
        if self.commanded != ZERO:
            return Call(success=False, message="there is torque")
        self.fault = ""
        return Call(success=True)

    @contextmanager
    def intruder(self, patience: float) -> Iterator[None]:
        self.step()
        self.latch("second publisher")
        yield


def moved(driver: Driver) -> tuple[Moves, dict[str, Finding]]:
    """Let the checker move a driver, and judge it."""
    checker: Any = driver
    moves = Checker(checker, CheckOptions(joints=JOINTS, move=True)).move()
    streams = {topic: [one for one in kept if one] for topic, kept in driver.kept.items()}
    record = Record(
        joints=JOINTS, paced=True, endpoints=[], streams={}, moving=streams, moves=moves, most=0.3
    )
    told = ("torque:", "torque_sensors: sign", "stale", "emergency stop", "second publisher")
    return moves, {one.check: one for one in judge(record) if one.check.startswith(told)}


@pytest.mark.parametrize(
    ("defects", "expected"),
    [
        ({}, []),
        (
            {"watchdog": False},
            ["stale commands: told", "stale commands: torque", "stale commands: latched"],
        ),
        ({"lets_go": False}, ["stale commands: torque"]),
        ({"latches": False}, ["stale commands: latched"]),
    ],
)
def test_what_a_driver_does_without_commands_is_seen_in_real_time(
    defects: dict[str, bool], expected: list[str]
) -> None:
    moves, findings = moved(Driver(**defects))  # type: ignore[arg-type]
    assert with_outcome(findings.values(), Outcome.FAIL) == expected
    assert with_outcome(findings.values(), Outcome.INCONCLUSIVE) == []
    assert moves.missing == ""


def test_when_commands_are_held_up_and_the_driver_stops_expect_no_judgement() -> None:
    moves, findings = moved(Driver(held_up=lambda tick: tick in range(1500, 1510)))
    assert moves.missing.startswith("the driver stopped: arm_sim: rig: no command")
    assert 0.009 < moves.gap < 0.012
    assert findings["torque: no stop"].outcome is Outcome.INCONCLUSIVE
    assert findings["torque: motion"].outcome is Outcome.PASS


def test_a_driver_that_stops_under_regular_commands_is_named() -> None:
    moves, findings = moved(Driver(moody=True))
    assert moves.fault == "arm_sim: rig: the mood"
    assert findings["torque: no stop"].outcome is Outcome.FAIL


# --- The checker's limit of motion --------------------------------------------------------------


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


@pytest.mark.parametrize("values", [(1.31, -2.0), (1.0, -2.4), (math.nan, -2.0), (1.0, math.inf)])
def test_beyond_the_limit_and_where_it_is_not_known_there_is_no_torque_any_more(
    guard: MotionGuard, values: tuple[float, float]
) -> None:
    assert not guard.allows(angles(*values))
    assert "torque taken away" in guard.objection
    # Coming back is no excuse.
    assert not guard.allows(angles(1.0, -2.0))


@pytest.mark.parametrize("message", [None, angles(1.0, -2.0, names=("shoulder", "wrist"))])
def test_angles_that_cannot_be_read_take_the_torque_away(
    guard: MotionGuard, message: Message | None
) -> None:
    assert not guard.allows(message)
    assert guard.objection.startswith("the angles cannot be read")
