"""The safety limiter: each limit with each action, the ramp, what is not finite."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled_entry
from armimp_common.topics import PERIOD
from armimp_control.safety_limiter import (
    CLIPPED,
    FAULT,
    JOURNAL,
    LIMITER_ROWS,
    LIMITS,
    PRESENT,
    STOPPED,
    WINDOW,
    Limiter,
    SaturationCounter,
    check_sample,
    continue_ramp,
    fault_of,
    limit_command,
    stop_commands,
)
from support.laws import torque_only

WIDE = torque_only(1e6)
Vector = tuple[float, ...]
BAD = [np.nan, np.inf, -np.inf]
_check = compiled_entry(check_sample)
_limit = compiled_entry(limit_command)


class SafetyLimiter:
    """A limiter of its own, fed tick by tick."""

    def __init__(self, joints: int = 2, **limits: Any) -> None:
        rules = WIDE.model_copy(update=limits).rules(np.zeros(joints))
        self.journal = np.zeros(JOURNAL)
        self.arrays = Limiter(rules, np.zeros((LIMITER_ROWS, joints)), self.journal)
        self.command = np.zeros(joints)
        self.clipped = 0

    def tick(
        self,
        command: Vector,
        theta: Vector | None = None,
        tau_h: Vector | None = None,
        tau_delta: Vector | None = None,
    ) -> FloatArray:
        still = (0.0,) * self.command.size
        sample = [still if values is None else values for values in (theta, tau_h, tau_delta)]
        _check(np.array(sample), self.arrays)
        self.command = np.array(command)
        self.clipped = _limit(self.command, self.arrays)
        return self.command

    @property
    def stopped(self) -> bool:
        return bool(self.journal[STOPPED])

    @property
    def fault(self) -> str:
        return fault_of(self.arrays, FAULT)[1]

    @property
    def present(self) -> str:
        return fault_of(self.arrays, PRESENT)[1]

    def count(self, limit: str) -> int:
        counts = {one: int(self.journal[CLIPPED + i]) for i, one in enumerate(LIMITS)}
        assert sum(counts.values()) == counts[limit]
        return counts[limit]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("theta", "position of joint"),
        ("tau_h", "torque reading of joint"),
        ("tau_delta", "perturbation of joint"),
        ("command", "torque from the control law for joint"),
    ],
)
def test_one_bad_number_takes_the_torque_from_all_joints_at_once(
    where: str, said: str, joint: int, bad: float
) -> None:
    limiter = SafetyLimiter(3)
    limiter.tick((30.0, -40.0, 50.0))
    values = [0.0, 0.0, 0.0]
    values[joint] = bad
    inputs = {"command": (30.0, -40.0, 50.0), where: tuple(values)}
    assert not limiter.tick(**inputs).any()
    assert limiter.fault == f"{said} {joint + 1} is not finite: {bad}"
    assert not limiter.tick((30.0, -40.0, 50.0)).any()
    assert limiter.fault.startswith(said)  # the first cause stays
    assert limiter.present == ""


@pytest.mark.parametrize(("theta", "joint"), [((0.21, 0.0), 1), ((0.0, -0.61), 2)])
def test_position_beyond_its_limit_stops(theta: Vector, joint: int) -> None:
    limiter = SafetyLimiter(position_limit=(0.2, 0.6))
    limiter.tick((5.0, 5.0), (0.2, -0.6))
    assert not limiter.stopped
    limiter.tick((5.0, 5.0), theta)
    assert limiter.stopped
    value, limit = max(theta, key=abs), (0.2, 0.6)[joint - 1]
    said = f"joint {joint} is {value} rad away from the posture, beyond the limit of {limit} rad"
    assert limiter.fault == limiter.present == said
    limiter.tick((5.0, 5.0), (0.0, 0.0))
    assert (limiter.fault, limiter.present) == (said, "")


def ramp_up(speed: float, ticks: int) -> list[Vector]:
    return [(k * speed * PERIOD, 0.0) for k in range(ticks)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_velocity_beyond_its_limit_stops(sign: float) -> None:
    said = f"velocity of joint 1 is {sign * 4.1} rad/s, beyond the limit of 4 rad/s"
    for speed, fault in ((3.9, ""), (4.1, said)):
        limiter = SafetyLimiter(velocity_limit=(4.0,))
        for theta in ramp_up(sign * speed, 20):
            limiter.tick((1.0, 1.0), theta)
        assert (limiter.stopped, limiter.fault) == (fault != "", fault)


def test_velocity_is_a_difference_over_the_window_so_one_count_does_not_stop() -> None:
    count = 2.0 * np.pi / 51200
    assert count / PERIOD > 0.12
    limiter = SafetyLimiter(velocity_limit=(0.025,))
    for k in range(50):
        limiter.tick((1.0, 1.0), (count * (k % 2 if k > WINDOW else 0), 0.0))
    assert not limiter.stopped
    limiter = SafetyLimiter(velocity_limit=(0.024,))
    for _ in range(WINDOW):
        limiter.tick((1.0, 1.0))
    limiter.tick((1.0, 1.0), (count, 0.0))
    assert limiter.stopped


def test_when_a_joint_is_asked_for_too_much_torque_expect_less_of_all_in_proportion() -> None:
    limiter = SafetyLimiter(torque_limit=80.0)
    assert limiter.tick((40.0, -160.0)).tolist() == [20.0, -80.0]
    assert limiter.clipped == limiter.count("torque") == 2
    assert limiter.tick((0.0, 1e300)).tolist() == [0.0, 80.0]
    assert limiter.clipped == 1
    assert limiter.tick((80.0, -80.0)).tolist() == [80.0, -80.0]
    assert limiter.clipped == 0
    assert limiter.count("torque") == 3


def test_torque_beyond_a_limit_that_stops_ramps_down_from_the_last_command() -> None:
    limiter = SafetyLimiter(torque_limit=80.0, torque_action="stop", ramp_time=0.004)
    limiter.tick((40.0, -80.0))
    outputs = [limiter.tick((0.0, 80.5)).tolist() for _ in range(6)]
    assert outputs == [[30.0, -60.0], [20.0, -40.0], [10.0, -20.0], [0.0, 0.0], *[[0.0, 0.0]] * 2]
    assert limiter.fault == "torque asked of joint 2 is 80.5 N·m, beyond the limit of 80 N·m"
    assert limiter.clipped == 0


def test_power_beyond_its_limit_is_clipped_joint_by_joint() -> None:
    limiter = SafetyLimiter(power_limit=10.0)
    for theta in ramp_up(2.0, 10):
        output = limiter.tick((50.0, 50.0), theta)
    assert output == pytest.approx([5.0, 50.0], rel=1e-12)
    assert limiter.tick((-50.0, 50.0), (20e-3, 0.0)) == pytest.approx([-5.0, 50.0], rel=1e-12)
    assert limiter.count("power") == 10


@pytest.mark.parametrize(("ramp_time", "ticks"), [(0.05, 50), (0.01, 10), (0.001, 1), (0.0, 1)])
def test_after_a_stop_the_torque_falls_in_a_straight_line(ramp_time: float, ticks: int) -> None:
    limiter = SafetyLimiter(ramp_time=ramp_time)
    limiter.tick((50.0, -20.0))
    stop_commands(ticks, limiter.arrays)
    outputs = np.array([limiter.tick((50.0, -20.0)) for _ in range(ticks + 20)])
    line = np.clip(1.0 - np.arange(1, ticks + 21) / ticks, 0.0, None)
    assert outputs == pytest.approx(line[:, None] * [50.0, -20.0], abs=1e-9)
    assert not outputs[ticks - 1 :].any()


def test_when_no_samples_come_the_ramp_goes_on_by_the_ticks_that_have_passed() -> None:
    limiter = SafetyLimiter(ramp_time=0.05)
    limiter.tick((50.0, -50.0))
    stop_commands(50, limiter.arrays)
    for ticks, left in ((10, 40.0), (0, 40.0), (39, 1.0), (100, 0.0)):
        continue_ramp(ticks, limiter.command, limiter.arrays)
        assert limiter.command == pytest.approx([left, -left])
    assert not limiter.command.any()


def ledger_of(ticks: dict[int, int]) -> SaturationCounter:
    ledger = SaturationCounter()
    for tick, clipped in sorted(ticks.items()):
        ledger.add(tick, clipped)
    return ledger


def intervals(ledger: SaturationCounter) -> list[tuple[int, int]]:
    pairs = [text.split("-") for text in ledger.text.split()]
    return [(int(first), int(last)) for first, last in pairs]


def test_when_there_are_too_many_intervals_expect_the_nearest_to_become_one() -> None:
    most = SaturationCounter.MOST_INTERVALS
    found = intervals(ledger_of(dict.fromkeys((*range(0, 10 * most, 10), 10 * most - 8), 1)))
    assert len(found) == most
    assert found[-1] == (10 * most - 10, 10 * most - 8)
    assert found[:-1] == [(10 * k, 10 * k) for k in range(most - 1)]


@given(st.dictionaries(st.integers(0, 2000), st.integers(1, 7), max_size=400))
def test_intervals_hold_every_clipped_tick_in_order_and_are_few(ticks: dict[int, int]) -> None:
    ledger = ledger_of(ticks)
    found = intervals(ledger)
    assert ledger.clipped == sum(ticks.values())
    assert len(found) <= SaturationCounter.MOST_INTERVALS
    assert all(any(first <= tick <= last for first, last in found) for tick in ticks)
    assert all(first in ticks and last in ticks for first, last in found)
    assert all(one[1] + 1 < later[0] for one, later in pairwise(found))
