"""The experiment without ROS: reproducible to the bit, alone or side by side."""

from typing import Any

import numpy as np
import pytest

from armimp_bringup.offline import run_offline
from armimp_bringup.parameters import NodeParameters
from armimp_common.arrays import FloatArray as Array
from armimp_common.errors import DataError
from armimp_estimation.record import TrialRecord
from armimp_sim.dynamics import WIDTH
from armimp_sim.presets import human_arm
from support.compiled import brief_rig
from support.laws import torque_only


def _arrays(trial: TrialRecord) -> Array:
    """Angles, torques, commands and perturbations, (4, n, N)."""
    return np.stack([trial.position, trial.torque, np.array(trial.command), trial.perturbation])


def _same(one: TrialRecord, other: TrialRecord) -> bool:
    return np.array_equal(_arrays(one), _arrays(other))


def test_same_seed_gives_the_same_bits_and_another_seed_other_ones() -> None:
    first, again, other = (run_offline([brief_rig(seed=seed)])[0] for seed in (3, 3, 8))
    assert all(_same(one, two) for one, two in zip(first, again, strict=True))
    for one, two in zip(first, other, strict=True):
        assert not any(map(np.array_equal, _arrays(one), _arrays(two)))


IMPERFECTIONS: tuple[dict[str, Any], ...] = (
    {"sensors.torque.delay": 0.0021, "sensors.torque.offset": [0.3]},
    {"sensors.torque.cutoff": 200.0, "sensors.torque.hysteresis": 0.1},
    {"actuators.bandwidth": 159.0, "sensors.torque.drift": [0.0, 1.0]},
    {"actuators.delay": 0.00135, "actuators.ripple": 0.1, "sensors.torque.cross_talk": 0.1},
    {"reflex.velocity_gain": [0.3], "muscle.cubic": -3.0, "muscle.short_range_stiffness": [2.0]},
)


def _another(lane: int, cuff: float) -> NodeParameters:
    """An experiment in which nothing is as in the one of another lane."""
    return brief_rig(
        friction=lane % 4,
        level=max(lane % 4, 1),
        seed=10 + lane,
        arm_sim={
            **IMPERFECTIONS[lane % len(IMPERFECTIONS)],
            "cuff.stiffness": cuff,
            "cuff.damping": 2e-3 * cuff,
            "arm.posture": [0.02 * lane + angle for angle in human_arm(2).posture],
            "voluntary.rms": 0.02 * (lane + 1),
        },
        imbic_controller={
            "law.gamma": 90.0 + 0.2 * lane,
            "target.damping": [2.0 + 0.2 * lane, 1.0 + 0.2 * lane],
        },
        safety=torque_only(10.0 + lane),
    )


@pytest.mark.parametrize("cuff", [0.0, pytest.param(1e4, marks=pytest.mark.slow)])
def test_experiments_side_by_side_give_the_bits_that_each_gives_alone(cuff: float) -> None:
    # One more than fit into one block.
    rigs = [_another(lane, cuff) for lane in range(WIDTH + 1)]
    together = run_offline(rigs)
    for lane in (0, 1, 3, WIDTH - 1, WIDTH):
        (alone,) = run_offline([rigs[lane]])
        assert list(map(_same, alone, together[lane])) == [True, True]
    assert len({trials[0].position[0, -1] for trials in together}) == len(rigs)


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ({"position_limit": (0.01,)}, r"trial 1: joint 1 is -?0\.01\d* rad away from the posture"),
        ({"velocity_limit": (9.0, 0.1)}, "velocity of joint 2 is .* beyond the limit of 0.1 rad/s"),
        ({"rate_action": "stop", "rate_limit": 1e4}, "changes by .* in a tick"),
    ],
)
def test_when_the_limiter_stops_an_experiment_expect_no_result_but_the_reason(
    limits: dict[str, Any], reason: str
) -> None:
    rig = brief_rig(safety=torque_only(80.0).model_copy(update=limits))
    with pytest.raises(DataError, match=reason):
        run_offline([brief_rig(), rig])
