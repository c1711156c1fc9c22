"""The benchmark of the node graph: what is measured is told apart, and adds up."""

from typing import Any

import pytest

from armimp_bringup.bench import Measured
from armimp_bringup.config import ExperimentConfig
from benchmarks.graph import RATIO_LIMIT, Processes, Round, graph_figures
from benchmarks.tick_parts import TickParts, tick_parts

PARTS = TickParts(plant=25e-6, law=3e-6, codecs=4e-6, recording=5e-6)


def figures(processes: Processes, tick: float, lost: int = 0) -> dict[str, Measured]:
    same: dict[str, Any] = {"plant": 25e-6, "lost": lost, "loops": [1e-3, 2e-3]}
    rounds = [
        Round(bare=bare, ticks=[tick - spread, tick + spread], stolen=spread, **same)
        for bare, spread in ((39e-6, 1e-6), (40e-6, 0.0), (90e-6, 5e-6))
    ]
    measured = graph_figures(processes, rounds, [PARTS], limit=5.0)
    return {one.key.removeprefix(f"{processes}_"): one for one in measured}


@pytest.mark.parametrize(("tick", "met"), [(80e-6, True), (82e-6, False)])
def test_the_target_of_the_ratio_leaves_out_the_plant_and_both_are_told(
    tick: float, met: bool
) -> None:
    found = figures("composed", tick)

    assert found["ratio"].limit == RATIO_LIMIT
    assert found["ratio"].value == pytest.approx((tick - 25e-6) / 40e-6)
    assert found["ratio"].missed is not met
    assert found["ratio_with_plant"].value == pytest.approx(tick / 40e-6)
    assert found["ratio_with_plant"].limit is None


def test_a_lost_sample_and_a_slow_trial_miss_the_target() -> None:
    assert figures("composed", 85e-6, lost=1)["lost"].missed
    assert not figures("composed", 85e-6)["lost"].missed
    assert not figures("composed", 194e-6)["slowest"].missed
    assert figures("composed", 196e-6)["slowest"].missed


def test_each_part_of_a_tick_takes_time_and_the_recording_is_complete() -> None:
    parts = tick_parts(ExperimentConfig(duration=10.0), 200)

    assert min(parts.plant, parts.law, parts.codecs, parts.recording) > 0.0
