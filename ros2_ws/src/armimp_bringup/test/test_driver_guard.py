"""The checker's limit of motion, and its witness of the machine."""

import math
import time

import numpy as np
import pytest

from armimp_bringup.driver_check.guard import MotionGuard
from armimp_bringup.driver_check.witness import Witness, stalls
from armimp_common.cdr import JointStateEncoder

ENCODE = JointStateEncoder(["shoulder", "elbow"], "position").encode


@pytest.fixture
def guard() -> MotionGuard:
    guard = MotionGuard(("shoulder", "elbow"), 0.3)
    assert guard.look(ENCODE(0, (1.0, -2.0)))
    return guard


def test_motion_within_the_limit_is_allowed_and_the_largest_kept(guard: MotionGuard) -> None:
    assert guard.look(ENCODE(1, (1.1, -2.25)))
    assert guard.look(ENCODE(2, (1.0, -2.0)))
    assert guard.largest == pytest.approx(0.25)
    assert guard.reason == ""


@pytest.mark.parametrize("angles", [(1.31, -2.0), (1.0, -2.4), (math.nan, -2.0), (1.0, math.inf)])
def test_beyond_the_limit_and_where_it_is_not_known_there_is_no_torque_any_more(
    guard: MotionGuard, angles: tuple[float, float]
) -> None:
    assert not guard.look(ENCODE(1, angles))
    assert "torque taken away" in guard.reason
    # Coming back is no excuse.
    assert not guard.look(ENCODE(2, (1.0, -2.0)))


def test_angles_that_cannot_be_read_take_the_torque_away(guard: MotionGuard) -> None:
    other = JointStateEncoder(["shoulder", "wrist"], "position").encode
    assert not guard.look(other(1, (1.0, -2.0)))
    assert "lacks joint 'elbow'" in guard.reason


def test_arrivals_are_excused_by_a_stall_between_due_and_come() -> None:
    found = stalls([(100, 200), (1000, 1500)], 10_000)
    arrivals = np.array([90, 210, 900, 1600, 2000], dtype=np.int64)
    delay = np.array([0.0, 50e-9, 300e-9, 700e-9, 300e-9])
    assert found.excuse(arrivals, delay).tolist() == [False, True, False, True, False]
    assert found.share == pytest.approx(0.06)
    assert found.longest == pytest.approx(500e-9)


def test_the_witness_notes_that_its_process_was_held_up() -> None:
    witness = Witness()
    time.sleep(0.02)
    # One call into C that keeps the interpreter for itself.
    begin = time.monotonic_ns()
    sum(range(3_000_000))
    end = time.monotonic_ns()
    time.sleep(0.02)
    found = witness.stalls()
    witness.close()
    inside = (found.begin_ns < end) & (found.end_ns > begin)
    assert np.any(inside & (found.end_ns - found.begin_ns > 5_000_000))
