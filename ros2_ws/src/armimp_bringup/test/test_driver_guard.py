"""The checker's limit of motion."""

import math

import pytest

from armimp_bringup.driver_check.conversation import MotionGuard
from armimp_common.cdr import JointStateEncoder

ENCODE = JointStateEncoder(["shoulder", "elbow"], "position").encode


@pytest.fixture
def guard() -> MotionGuard:
    guard = MotionGuard(("shoulder", "elbow"), 0.3)
    assert guard.allows(ENCODE(0, (1.0, -2.0)))
    return guard


def test_motion_within_the_limit_is_allowed_and_the_largest_kept(guard: MotionGuard) -> None:
    assert guard.allows(ENCODE(1, (1.1, -2.25)))
    assert guard.allows(ENCODE(2, (1.0, -2.0)))
    assert guard.largest == pytest.approx(0.25)
    assert not guard.objection


@pytest.mark.parametrize("angles", [(1.31, -2.0), (1.0, -2.4), (math.nan, -2.0), (1.0, math.inf)])
def test_beyond_the_limit_and_where_it_is_not_known_there_is_no_torque_any_more(
    guard: MotionGuard, angles: tuple[float, float]
) -> None:
    assert not guard.allows(ENCODE(1, angles))
    assert "torque taken away" in guard.objection
    # Coming back is no excuse.
    assert not guard.allows(ENCODE(2, (1.0, -2.0)))


def test_angles_that_cannot_be_read_take_the_torque_away(guard: MotionGuard) -> None:
    other = JointStateEncoder(["shoulder", "wrist"], "position").encode
    assert not guard.allows(other(1, (1.0, -2.0)))
    assert guard.objection.startswith("an angle cannot be read")
