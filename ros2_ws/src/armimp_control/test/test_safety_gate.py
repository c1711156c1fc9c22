"""The safety gate: each limit with each action, the ramp, what is not finite."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_control.faults import clip_counts, in_words
from armimp_control.safety import Action, Limit, SafetyConfig
from armimp_control.safety_limiter import (
    CLOSED,
    FAULT,
    GATE_ROWS,
    JOURNAL,
    PRESENT,
    WINDOW,
    close_gate,
    examine,
    fall,
    let_through,
)
from support.safety import torque_only

PERIOD = 1e-3
WIDE = torque_only(1e6)
Vector = tuple[float, ...]
BAD = [np.nan, np.inf, -np.inf]


class SafetyLimiter:
    """A gate of its own, fed tick by tick."""

    def __init__(self, joints: int = 2, *, config: SafetyConfig = WIDE, **limits: Any) -> None:
        self.rules = replace(config, **limits).rules(np.zeros(joints), PERIOD)
        self.memory = np.zeros((GATE_ROWS, joints))
        self.journal = np.zeros(JOURNAL)
        self.command = np.zeros(joints)
        self.clipped = 0

    def tick(
        self,
        command: Vector,
        theta: Vector | None = None,
        tau_h: Vector | None = None,
        tau_delta: Vector | None = None,
    ) -> NDArray[np.float64]:
        still = (0.0,) * self.command.size
        sample, torque, perturbation = (
            np.array(still if values is None else values) for values in (theta, tau_h, tau_delta)
        )
        examine(sample, torque, perturbation, self.rules, PERIOD, self.memory, self.journal)
        self.command = np.array(command)
        self.clipped = let_through(self.command, self.rules, self.memory, self.journal)
        return self.command

    @property
    def closed(self) -> bool:
        return bool(self.journal[CLOSED])

    @property
    def fault(self) -> str:
        return in_words(self.journal, FAULT, self.rules)

    @property
    def present(self) -> str:
        return in_words(self.journal, PRESENT, self.rules)

    def count(self, limit: Limit) -> int:
        counts = clip_counts(self.journal)
        assert sum(counts.values()) == counts[limit]
        return counts[limit]


def test_command_within_all_limits_passes_unchanged() -> None:
    gate = SafetyLimiter(config=SafetyConfig())
    for command in ((80.0, -80.0), (-0.0, 5e-324), (1.0 / 3.0, -70.0)):
        assert gate.tick(command).tobytes() == np.array(command).tobytes()
        assert gate.clipped == 0
    assert not gate.closed
    assert gate.fault == gate.present == ""


# --- what is not finite ----------------------------------------------------------------------


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
    gate = SafetyLimiter(3)
    gate.tick((30.0, -40.0, 50.0))
    values = [0.0, 0.0, 0.0]
    values[joint] = bad
    inputs = {"command": (30.0, -40.0, 50.0), where: tuple(values)}
    assert not gate.tick(**inputs).any()
    assert gate.fault == f"{said} {joint + 1} is not finite: {bad}"
    assert not gate.tick((30.0, -40.0, 50.0)).any()
    assert gate.fault.startswith(said)  # the first cause stays
    assert gate.present == ""


def test_bad_number_during_a_ramp_ends_the_ramp() -> None:
    gate = SafetyLimiter(ramp_time=0.05)
    gate.tick((50.0, -50.0))
    close_gate(50, True, gate.memory, gate.journal)
    assert gate.tick((50.0, -50.0)).all()
    assert not gate.tick((50.0, -50.0), theta=(np.nan, 0.0)).any()
    assert not gate.tick((50.0, -50.0)).any()


# --- position and velocity -------------------------------------------------------------------


@pytest.mark.parametrize(("theta", "joint"), [((0.21, 0.0), 1), ((0.0, -0.61), 2)])
def test_position_beyond_its_limit_stops(theta: Vector, joint: int) -> None:
    gate = SafetyLimiter(position_limit=(0.2, 0.6))
    gate.tick((5.0, 5.0), (0.2, -0.6))
    assert not gate.closed
    gate.tick((5.0, 5.0), theta)
    assert gate.closed
    value, limit = max(theta, key=abs), (0.2, 0.6)[joint - 1]
    said = f"joint {joint} is {value} rad away from the posture, beyond the limit of {limit} rad"
    assert gate.fault == gate.present == said
    gate.tick((5.0, 5.0), (0.0, 0.0))
    assert (gate.fault, gate.present) == (said, "")


def test_position_counts_from_the_posture() -> None:
    gate = SafetyLimiter(position_limit=(0.2,))
    gate.rules = SafetyConfig(position_limit=(0.2,)).rules(np.array([1.0, -1.0]), PERIOD)
    gate.tick((0.0, 0.0), (1.1, -1.1))
    assert not gate.closed
    gate.tick((0.0, 0.0), (1.1, -0.7))
    assert gate.closed


def test_beyond_a_position_limit_that_clips_only_inward_torque_passes() -> None:
    gate = SafetyLimiter(position_limit=(0.2,), position_action=Action.CLIP)
    assert gate.tick((5.0, 5.0), (0.3, -0.3)).tolist() == [0.0, 5.0]
    assert gate.tick((-5.0, -5.0), (0.3, -0.3)).tolist() == [-5.0, 0.0]
    assert gate.tick((5.0, -5.0), (0.2, -0.2)).tolist() == [5.0, -5.0]
    assert (gate.closed, gate.count(Limit.POSITION)) == (False, 2)


def ramp_up(speed: float, ticks: int) -> list[Vector]:
    return [(k * speed * PERIOD, 0.0) for k in range(ticks)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_velocity_beyond_its_limit_stops(sign: float) -> None:
    gate = SafetyLimiter(velocity_limit=(4.0,))
    for theta in ramp_up(sign * 3.9, 20):
        gate.tick((1.0, 1.0), theta)
    assert not gate.closed
    gate = SafetyLimiter(velocity_limit=(4.0,))
    for theta in ramp_up(sign * 4.1, 20):
        gate.tick((1.0, 1.0), theta)
    assert gate.closed
    assert gate.fault == f"velocity of joint 1 is {sign * 4.1} rad/s, beyond the limit of 4 rad/s"


def test_velocity_is_a_difference_over_the_window_so_one_count_does_not_stop() -> None:
    count = 2.0 * np.pi / 51200
    assert count / PERIOD > 0.12
    gate = SafetyLimiter(velocity_limit=(0.025,))
    for k in range(50):
        gate.tick((1.0, 1.0), (count * (k % 2 if k > WINDOW else 0), 0.0))
    assert not gate.closed
    gate = SafetyLimiter(velocity_limit=(0.024,))
    for _ in range(WINDOW):
        gate.tick((1.0, 1.0))
    gate.tick((1.0, 1.0), (count, 0.0))
    assert gate.closed


def test_first_sample_has_no_velocity_wherever_it_is() -> None:
    gate = SafetyLimiter(velocity_limit=(1e-6,))
    gate.tick((1.0, 1.0), (3.0, -3.0))
    assert not gate.closed
    gate.tick((1.0, 1.0), (3.0, -3.0 + 1e-3))
    assert "velocity of joint 2 is 1 rad/s" in gate.fault


def test_beyond_a_velocity_limit_that_clips_only_braking_torque_passes() -> None:
    gate = SafetyLimiter(velocity_limit=(1.0,), velocity_action=Action.CLIP)
    *_, last = ((gate.tick((5.0, 5.0), theta)).tolist() for theta in ramp_up(2.0, 4))
    assert last == [0.0, 5.0]
    assert gate.tick((-5.0, 5.0), (8e-3, 0.0)).tolist() == [-5.0, 5.0]
    assert (gate.closed, gate.count(Limit.VELOCITY)) == (False, 3)


# --- torque, rate, power ---------------------------------------------------------------------


def test_torque_beyond_its_limit_is_clipped_and_counted() -> None:
    gate = SafetyLimiter(torque_limit=80.0)
    assert gate.tick((80.1, -1e300)).tolist() == [80.0, -80.0]
    assert gate.clipped == gate.count(Limit.TORQUE) == 2
    assert gate.tick((80.0, -80.0)).tolist() == [80.0, -80.0]
    assert gate.clipped == 0
    assert gate.count(Limit.TORQUE) == 2


def test_torque_beyond_a_limit_that_stops_ramps_down_from_the_last_command() -> None:
    gate = SafetyLimiter(torque_limit=80.0, torque_action=Action.STOP, ramp_time=0.004)
    gate.tick((40.0, -80.0))
    outputs = [gate.tick((0.0, 80.5)).tolist() for _ in range(6)]
    assert outputs == [[30.0, -60.0], [20.0, -40.0], [10.0, -20.0], [0.0, 0.0], *[[0.0, 0.0]] * 2]
    assert gate.fault == "torque asked of joint 2 is 80.5 N·m, beyond the limit of 80 N·m"
    assert gate.clipped == 0


def test_torque_that_changes_too_fast_is_clipped_and_counted() -> None:
    gate = SafetyLimiter(torque_limit=80.0, rate_limit=2e4)
    assert gate.tick((50.0, -19.0)).tolist() == [20.0, -19.0]
    assert gate.tick((50.0, -19.0)).tolist() == [40.0, -19.0]
    assert gate.tick((50.0, 2.0)).tolist() == [50.0, 1.0]
    assert gate.tick((-50.0, 0.0)).tolist() == [30.0, 0.0]
    assert gate.count(Limit.RATE) == 4


def test_rate_beyond_a_limit_that_stops_is_told_in_the_words_of_a_tick() -> None:
    gate = SafetyLimiter(torque_limit=80.0, rate_limit=2e4, rate_action=Action.STOP)
    gate.tick((15.0, 0.0))
    gate.tick((-10.0, 0.0))
    assert gate.closed
    assert gate.fault == (
        "torque asked of joint 1 changes by -25 N·m in a tick, beyond the limit of 20 N·m"
    )


def test_power_beyond_its_limit_is_clipped_joint_by_joint() -> None:
    gate = SafetyLimiter(power_limit=10.0)
    for theta in ramp_up(2.0, 10):
        output = gate.tick((50.0, 50.0), theta)
    assert output == pytest.approx([5.0, 50.0], rel=1e-12)
    assert gate.tick((-50.0, 50.0), (20e-3, 0.0)) == pytest.approx([-5.0, 50.0], rel=1e-12)
    assert gate.count(Limit.POWER) == 10


def test_power_prevails_over_the_rate_but_only_towards_zero() -> None:
    gate = SafetyLimiter(torque_limit=80.0, rate_limit=1e4, power_limit=1.0)
    for _ in range(10):
        gate.tick((80.0, 0.0))
    assert gate.command[0] == 80.0
    assert gate.tick((80.0, 0.0), (5e-3, 0.0))[0] == pytest.approx(1.0)
    assert gate.tick((-80.0, 0.0), (5e-3, 0.0))[0] == pytest.approx(-1.0)


def test_power_beyond_a_limit_that_stops_is_told() -> None:
    gate = SafetyLimiter(power_limit=10.0, power_action=Action.STOP)
    for theta in ramp_up(2.0, 10):
        gate.tick((6.0, 50.0), theta)
    assert gate.fault == "power asked of joint 1 is 12 W, beyond the limit of 10 W"


# --- the ramp --------------------------------------------------------------------------------


@pytest.mark.parametrize(("ramp_time", "ticks"), [(0.05, 50), (0.01, 10), (0.001, 1), (0.0, 1)])
def test_after_a_stop_the_torque_falls_in_a_straight_line(ramp_time: float, ticks: int) -> None:
    gate = SafetyLimiter(ramp_time=ramp_time)
    gate.tick((50.0, -20.0))
    close_gate(ticks, True, gate.memory, gate.journal)
    outputs = np.array([gate.tick((50.0, -20.0)) for _ in range(ticks + 20)])
    line = np.clip(1.0 - np.arange(1, ticks + 21) / ticks, 0.0, None)
    assert outputs == pytest.approx(line[:, None] * [50.0, -20.0], abs=1e-9)
    assert not outputs[ticks - 1 :].any()


def test_power_during_a_ramp_stays_within_its_limit_and_the_torque_does_not_rise_again() -> None:
    gate = SafetyLimiter(power_limit=10.0, ramp_time=0.05)
    gate.tick((50.0, 0.0))
    close_gate(50, True, gate.memory, gate.journal)
    fast = [*ramp_up(10.0, 10), *[(0.09, 0.0)] * 40]
    outputs = [float(gate.tick((50.0, 0.0), theta)[0]) for theta in fast]
    assert min(outputs[5:10]) <= 1.0
    assert np.all(np.diff(outputs) <= 0.0)
    assert outputs[49] == 0.0


def test_when_no_samples_come_the_ramp_goes_on_by_the_ticks_that_have_passed() -> None:
    gate = SafetyLimiter(ramp_time=0.05)
    gate.tick((50.0, -50.0))
    close_gate(50, True, gate.memory, gate.journal)
    for ticks, left in ((10, 40.0), (0, 40.0), (39, 1.0), (100, 0.0)):
        fall(ticks, gate.command, gate.rules, gate.memory, gate.journal)
        assert gate.command == pytest.approx([left, -left])
    assert not gate.command.any()


def test_second_stop_makes_a_ramp_no_longer() -> None:
    gate = SafetyLimiter(ramp_time=0.05)
    gate.tick((50.0, 0.0))
    for _ in range(25):
        close_gate(50, True, gate.memory, gate.journal)
        gate.tick((50.0, 0.0))
    assert gate.command[0] == pytest.approx(25.0)


def test_cut_takes_the_torque_away_at_once() -> None:
    gate = SafetyLimiter()
    gate.tick((50.0, 0.0))
    close_gate(0, True, gate.memory, gate.journal)
    assert not gate.tick((50.0, 0.0)).any()


# --- configuration ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("torque_limit", [0.0, -80.0, float("nan"), float("inf")]),
        ("rate_limit", [0.0, -1.0, float("nan"), float("inf")]),
        ("power_limit", [0.0, -1.0, float("nan"), float("inf")]),
        ("watchdog_ticks", [0, -5, 101, 10**9, float("nan"), float("inf")]),
        ("ramp_time", [-0.01, 0.051, float("nan"), float("inf")]),
    ],
)
def test_limit_that_would_not_protect_is_refused_with_the_value(
    name: str, values: list[Any]
) -> None:
    for value in values:
        settings: dict[str, Any] = {name: value}
        with pytest.raises(ConfigurationError, match=f"{name} .*{value}"):
            SafetyConfig(**settings)


@pytest.mark.parametrize("name", ["position_limit", "velocity_limit"])
@pytest.mark.parametrize("value", [0.0, -0.5, float("nan"), float("inf")])
def test_limit_of_one_joint_that_would_not_protect_is_refused(name: str, value: float) -> None:
    settings: dict[str, Any] = {name: (1.0, value)}
    with pytest.raises(ConfigurationError, match=f"{name} must be positive .* got {value}"):
        SafetyConfig(**settings)


@pytest.mark.parametrize("values", [(), (1.0, 2.0), (1.0,) * 4])
def test_wrong_number_of_limits_is_refused(values: Vector) -> None:
    with pytest.raises(
        ConfigurationError, match=f"position_limit has {len(values)} values, needs 1 or 3"
    ):
        SafetyConfig(position_limit=values).rules(np.zeros(3), PERIOD)


def test_rate_limit_that_would_make_the_ramp_too_long_is_refused() -> None:
    slow = SafetyConfig(torque_limit=80.0, rate_limit=1599.0, ramp_time=0.05)
    with pytest.raises(
        ConfigurationError, match=r"rate_limit 1599\.0 .* torque_limit 80\.0 .* within 0\.05 s"
    ):
        slow.rules(np.zeros(2), PERIOD)
    replace(slow, rate_limit=1600.0).rules(np.zeros(2), PERIOD)
