"""The rig under a clock: it goes on without commands, and counts what it missed."""

import numpy as np
import pytest

from armimp_common.protection import RAMP_PERIODS, WATCHDOG_PERIODS
from armimp_common.realtime import Pacer
from armimp_common.topics import PERIOD_NS
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import HEARD_TICKS, RealtimeSimulator, SimulatedRig
from support.plants import in_lockstep, some_commands

PARAMETERS = SimulatorParameters.preset()
Command = tuple[float, ...]
SILENCE = f"no command for {WATCHDOG_PERIODS} periods"


class Bench:
    """A paced rig without its thread, on a clock that is moved by hand."""

    def __init__(self) -> None:
        self.ns = 10**12
        self.tick = 0
        self.rig = SimulatedRig(PARAMETERS)
        self.sent: list[tuple[int, Command, Command]] = []
        pacer = Pacer(now=lambda: self.ns, sleep=lambda _: None)
        self.paced = RealtimeSimulator(self.rig, self.send, pacer)
        self.start_ns = self.ns
        self.paced.begin()

    def send(self) -> None:
        rig = self.rig
        sample = rig.stamp_ns, tuple(rig.position.tolist()), tuple(rig.torque.tolist())
        self.sent.append(sample)

    def command(self, *command: float, after_us: int = 300) -> None:
        """Give a command so long after the deadline of the present sample."""
        self.ns = self.start_ns + self.tick * PERIOD_NS + after_us * 1000
        self.paced.command(command)

    def next(self, ticks: int = 1) -> None:
        """Let deadlines come."""
        for _ in range(ticks):
            self.tick += 1
            self.ns = max(self.ns, self.start_ns + self.tick * PERIOD_NS)
            self.paced.advance(self.tick)

    @property
    def missed(self) -> int:
        return self.paced.figures().missed


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_when_every_command_is_in_time_expect_the_samples_of_lockstep(bench: Bench) -> None:
    commands = some_commands(60)
    for command in commands:
        bench.command(*command)
        bench.next()
    assert bench.sent == in_lockstep(commands)
    assert bench.missed == 0


def test_when_a_command_is_missed_expect_the_last_one_held_and_counted(bench: Bench) -> None:
    a, b = some_commands(2)
    bench.command(*a)
    bench.next(3)
    assert bench.missed == 2
    assert bench.sent == in_lockstep([a, a, a])
    for _ in range(3):  # the answers to the second, third and fourth sample
        bench.command(*b)
    bench.next()
    assert bench.missed == 2
    assert bench.sent == in_lockstep([a, a, a, b])


def test_when_commands_stay_away_expect_a_straight_ramp_to_zero_within_fifty_milliseconds(
    bench: Bench,
) -> None:
    bench.command(10.0, -20.0)
    bench.next(WATCHDOG_PERIODS)
    assert not bench.rig.fault
    applied = []
    for _ in range(WATCHDOG_PERIODS + 50):
        bench.next()
        applied.append(bench.rig.applied)
    assert bench.rig.fault == SILENCE
    ramp = [1.0 - (k + 1) / RAMP_PERIODS for k in range(RAMP_PERIODS)]
    np.testing.assert_allclose(applied[: len(ramp)], np.outer(ramp, (10.0, -20.0)), atol=1e-12)
    assert RAMP_PERIODS <= 50
    assert set(applied[RAMP_PERIODS - 1 :]) == {(0.0, 0.0)}


@pytest.mark.parametrize(
    ("again", "unheard"),
    [(False, HEARD_TICKS), (False, 1000), (True, WATCHDOG_PERIODS), (True, 200)],
)
def test_samples_that_nobody_was_there_to_answer_are_owed_by_nobody(
    bench: Bench, again: bool, unheard: int
) -> None:
    if again:
        bench.command(1.0, 1.0)
        bench.next(40)
        bench.command(0.0, 0.0)
        bench.next()
        bench.rig.reset()
    bench.next(unheard + again)
    missed = bench.missed
    for _ in range(1000):
        bench.command(7.0, 7.0)
        bench.next()

    assert bench.missed == missed
    assert not bench.rig.fault
    assert bench.rig.applied == (7.0, 7.0)
    assert bench.paced.figures().latency_p99 == pytest.approx(300e-6, rel=0.021)
