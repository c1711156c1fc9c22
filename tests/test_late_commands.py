"""Commands that act late, or not at all in their period: what the experiment bears of that.

Rig and controller without ROS, on a clock that is moved by hand, so the machine does not matter.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np
import pytest
from pydantic import JsonValue

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_common.errors import ConfigurationError
from armimp_common.realtime import Pacer, TimingLimits
from armimp_common.topics import PERIOD_NS
from armimp_sim.simulator import RealtimeSimulator
from support.closed_loop import ClosedLoop

pytestmark = pytest.mark.slow

DEFAULT: Mapping[str, JsonValue] = {}
BORNE: Mapping[int, Mapping[str, JsonValue]] = {
    0: DEFAULT,
    1: DEFAULT,
    2: DEFAULT,
    3: {"law.gamma": 30.0, "target.lock_frequency": 30.0},
}
"""Settings by periods of delay."""
LONGEST = 3
"""Most periods in a row for which a command is late."""


def told(delay: int, settings: Mapping[str, JsonValue]) -> NodeParameters:
    """Parameters of a controller that knows of the delay (periods)."""
    changes: dict[str, JsonValue] = {"known.command_delay": delay, **settings}
    return node_parameters(ExperimentConfig(imbic_controller=changes), None)


@pytest.mark.parametrize("delay", BORNE)
def test_with_the_settings_of_the_documents_late_commands_cost_no_accuracy(delay: int) -> None:
    loop = ClosedLoop(told(delay, BORNE[delay]))
    under_way = deque([(0.0,) * loop.rig.position.size] * delay)
    while (command := loop.answer()) is not None:
        under_way.append(command)
        loop.rig.step(under_way.popleft())
    assert sum(loop.controller.clipped.values()) == 0
    loop.assert_accurate()


@pytest.mark.parametrize("delay", [3, 4])
def test_commands_that_are_too_late_for_the_default_settings_are_refused(delay: int) -> None:
    with pytest.raises(ConfigurationError, match=f"grows by .* act {delay} periods late"):
        told(delay, DEFAULT)


def test_with_as_many_missed_commands_as_are_allowed_the_accuracy_is_still_there() -> None:
    limit = TimingLimits().max_missed_share
    loop = ClosedLoop(node_parameters(ExperimentConfig(mode="realtime"), None))
    now = [0]
    pacer = Pacer(PERIOD_NS, now=lambda: now[0], sleep=lambda _: None)
    paced = RealtimeSimulator(loop.rig, lambda: None, pacer)
    rng = np.random.default_rng(8)
    waiting: list[tuple[float, ...]] = []
    late_for = tick = 0
    paced.begin()
    while (answer := loop.answer()) is not None:
        # One command in time at least between two runs of missed ones, for the watchdog's sake.
        in_time = not waiting
        waiting.append(answer)
        if in_time and rng.random() < limit / ((1 + LONGEST) / 2):
            late_for = int(rng.integers(1, LONGEST + 1))
        now[0] = tick * PERIOD_NS + 300_000
        if late_for:
            late_for -= 1
        else:
            for command in waiting:
                paced.command(command)
            waiting.clear()
        tick += 1
        now[0] = tick * PERIOD_NS
        paced.advance(tick)
    assert loop.rig.fault == ""
    figures = paced.figures()
    assert 0.8 * limit < figures.missed / figures.ticks < 1.2 * limit
    loop.assert_accurate()
