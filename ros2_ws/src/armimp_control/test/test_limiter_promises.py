"""What the safety limiter promises for every output, whatever comes in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common.errors import ConfigurationError
from armimp_control import presets
from armimp_control.laws.law import Controller
from armimp_control.safety_limiter import (
    RAMP,
    RATE,
    RULE_ROWS,
    STOPS,
    TORQUE,
    Action,
    SafetyParameters,
)
from support import limiter_campaign
from support.fault_figures import Figures
from support.limiter_campaign import PROMISES, campaign

ANY = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
SENSIBLE = st.floats(-0.6, 0.6)
ACTIONS = st.sampled_from(Action)
SIZES = st.floats(-3.0, 6.0).map(lambda exponent: 10.0**exponent)


@st.composite
def configs(draw: st.DrawFn) -> SafetyParameters:
    return SafetyParameters(
        position_limit=(draw(SIZES),),
        velocity_limit=(draw(SIZES), draw(SIZES)),
        torque_limit=draw(SIZES),
        rate_limit=draw(SIZES.map(lambda size: 1e5 * size)),
        power_limit=draw(SIZES),
        position_action=draw(ACTIONS),
        velocity_action=draw(ACTIONS),
        torque_action=draw(ACTIONS),
        rate_action=draw(ACTIONS),
        power_action=draw(ACTIONS),
        ramp_time=draw(st.floats(0.0, 0.05)),
    )


def _controller(config: SafetyParameters) -> Controller | None:
    try:
        return Controller(
            presets.imbic(np.array([[0.354, 0.191], [0.191, 0.180]]), np.zeros(2)), safety=config
        )
    except ConfigurationError:
        return None  # the ramp does not fit the rate


@settings(deadline=None, max_examples=300)
@given(
    configs(),
    st.lists(st.lists(SENSIBLE | ANY, min_size=6, max_size=6), min_size=1, max_size=12),
    st.sampled_from(["", "stop", "cut", "release"]),
    st.integers(0, 11),
)
def test_whatever_comes_in_the_torque_is_finite_limited_and_gone_after_a_fault(
    config: SafetyParameters, samples: list[list[float]], event: str, event_tick: int
) -> None:
    law = _controller(config)
    if law is None:
        return
    before, since = np.zeros(2), 0
    for tick, sample in enumerate(samples):
        if event and tick == event_tick:
            getattr(law, event)()
        law.tick(*np.array(sample).reshape(3, 2))
        assert np.all(np.abs(law.command) <= law.rules[TORQUE])
        if not np.all(np.isfinite(sample)):
            assert law.stopped
            assert not law.command.any()
        faster = np.abs(law.command - before) > law.rules[RATE] * (1.0 + 1e-9)
        # Only on the way to zero.
        assert np.all(np.abs(law.command[faster]) <= np.abs(before[faster]))
        since += law.stopped
        if law.stopped:
            assert np.all(np.abs(law.command) <= np.abs(before))
            assert np.all(law.command * before >= 0.0)
            assert not law.memory.any()
        if since >= law.rules[RAMP, 0]:
            assert not law.command.any()
        before = law.command.copy()
    if law.stopped:
        law.continue_ramp(50)
        assert not law.command.any()


def test_three_hundred_random_sequences_break_no_promise() -> None:
    result = campaign(300, seed=2026)
    assert result.violations == dict.fromkeys(PROMISES, 0)
    assert (result.sequences, result.ticks) == (300, 24_000)
    # It was no walk in the park.
    assert result.faults > 150
    assert result.poisoned > 150
    assert result.clipped > 3000


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_million_random_sequences_break_no_promise(figures: Figures) -> None:
    result = campaign(1_000_000, seed=1)
    assert result.violations == dict.fromkeys(PROMISES, 0)
    figures.add(
        "safety limiter fed a random sequence of 80 ticks",
        result.sequences,
        faults_latched=(result.faults, ""),
        broken_promises=(sum(result.violations.values()), ""),
    )


class TestJudge:
    """The judge of the campaign sees what it should see."""

    RULES = np.zeros((RULE_ROWS, 1))
    RULES[:5, 0] = 0.5, 4.0, 80.0, 10.0, 20.0
    RULES[RAMP, 0] = 5

    def output(
        self,
        command: float,
        before: float,
        *,
        speed: float = 0.0,
        poisoned: bool = False,
        cut: bool = False,
        fallen: int = 0,
    ) -> list[str]:
        broken = np.zeros(len(PROMISES), np.int64)
        limiter_campaign._judge_output(
            np.array([command]),
            np.array([before]),
            np.array([speed]),
            self.RULES,
            poisoned,
            cut,
            fallen,
            broken,
        )
        return [what for what, count in zip(PROMISES, broken, strict=True) if count]

    def passing(
        self, command: float, asked: float, *, speed: float = 0.0, far: float = 0.0, clipped: int
    ) -> list[str]:
        broken = np.zeros(len(PROMISES), np.int64)
        rules = self.RULES.copy()
        rules[STOPS] = 1.0
        limiter_campaign._judge_passing(
            np.array([command]),
            np.array([50.0]),
            np.array([asked]),
            np.array([speed]),
            np.array([far]),
            rules,
            clipped,
            broken,
        )
        return [what for what, count in zip(PROMISES, broken, strict=True) if count]

    def test_good_outputs_are_let_pass(self) -> None:
        assert self.output(59.0, 50.0) == []
        assert self.output(5.0, 70.0, speed=4.0) == []
        assert self.output(0.0, 70.0, poisoned=True) == []
        assert self.output(0.0, 70.0, cut=True, fallen=1) == []
        assert self.passing(55.0, 55.0, clipped=0) == []
        assert self.passing(60.0, 90.0, clipped=1) == []

    def test_each_broken_promise_is_seen(self) -> None:
        assert PROMISES[0] in self.output(np.nan, 0.0)
        assert self.output(81.0, 75.0) == [PROMISES[1]]
        assert self.output(61.0, 50.0) == [PROMISES[2]]
        assert self.output(20.0, 50.0, speed=0.5) == [PROMISES[2]]
        assert self.output(50.0, 50.0, speed=0.5) == [PROMISES[3]]
        assert self.output(1.0, 5.0, poisoned=True) == [PROMISES[4]]
        assert self.output(6.0, 5.0, fallen=2) == [PROMISES[5]]
        assert self.output(-1.0, 5.0, fallen=2) == [PROMISES[5]]
        assert self.output(1.0, 5.0, fallen=5) == [PROMISES[6]]
        assert self.passing(54.0, 55.0, clipped=1) == [PROMISES[7]]
        assert self.passing(60.0, 90.0, clipped=0) == [PROMISES[8]]
        assert self.passing(55.0, 55.0, far=0.6, clipped=0) == [PROMISES[9]]
