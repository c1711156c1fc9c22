"""Joint states of ros2_control: joints, signs, and stamps."""

import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from armimp_common.errors import ConfigurationError, MalformedMessageError
from armimp_common.schema import build
from armimp_common.status import to_time
from armimp_common.topics import PERIOD_NS
from armimp_ros2_control.parameters import BridgeParameters
from armimp_ros2_control.readings import Readings, Stamps

NAMES = ["gripper", "exo_elbow", "exo_shoulder"]
POSITION = [9.0, 1.3, 1.1]
EFFORT = [7.0, -0.2, 0.4]


def message(**changes: object) -> bytes:
    fields: dict[str, object] = {"name": NAMES, "position": POSITION, "effort": EFFORT, **changes}
    state = JointState(**fields)
    state.header.stamp = to_time(5 * PERIOD_NS)
    return bytes(serialize_message(state))


def readings(**changes: object) -> Readings:
    given = {"names": ("exo_shoulder", "exo_elbow"), **changes}
    return Readings(BridgeParameters.model_validate(given))


def test_our_joints_are_picked_by_name_whatever_else_there_is_in_whatever_order() -> None:
    assert readings().decode(message()) == (5 * PERIOD_NS, (1.1, 1.3), (0.4, -0.2))


def test_a_direction_turns_angle_torque_and_command_and_a_torque_sign_the_reading_alone() -> None:
    turned = readings(directions=(-1, 1), torque_signs=(-1, -1))
    assert turned.decode(message()) == (5 * PERIOD_NS, (-1.1, 1.3), (0.4, 0.2))
    assert turned.commands((3.0, 4.0)) == (-3.0, 4.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"name": ["gripper", "wrist", "exo_shoulder"]}, "lacks joint 'exo_elbow'"),
        ({"name": ["exo_elbow", "exo_elbow", "exo_shoulder"]}, "a joint twice"),
        ({"effort": []}, "0 effort values for 3 joints"),
        ({"position": [1.0]}, "1 position values for 3 joints"),
    ],
)
def test_what_is_missing_is_named(changes: dict[str, object], words: str) -> None:
    with pytest.raises(MalformedMessageError, match=words):
        readings().decode(message(**changes))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"names": ["a", "b", "c"]}, "3 names for 2 joints"),
        ({"directions": [1, 1, 1]}, "'directions' has 3 values for 2 joints"),
        ({"torque_signs": [1, 2]}, r"'torque_signs\[1\]' = 2: input should be 1 or -1"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        Readings(build(BridgeParameters, changes))


def steps(stamps_ms: list[float]) -> tuple[list[int], Stamps]:
    rule = Stamps()
    return [rule.step(round(1e6 * stamp)) for stamp in stamps_ms], rule


def test_a_late_sample_leaves_a_gap_and_the_next_is_left_out_so_that_the_count_is_right() -> None:
    found, rule = steps([0.0, 1.7, 2.0, 3.0, 4.0])
    assert found == [1, 2, 0, 1, 1]
    assert sum(found[1:]) == 4
    assert (rule.left_out, rule.lost) == (1, 1)


def test_samples_that_never_came_are_counted() -> None:
    found, rule = steps([0.0, 1.0, 4.0, 5.0])
    assert found == [1, 1, 3, 1]
    assert rule.lost == 2


@pytest.mark.parametrize("last", [3.0, 2.5])
def test_when_time_stands_still_or_goes_back_expect_a_refusal(last: float) -> None:
    with pytest.raises(MalformedMessageError, match="does not come after the last one"):
        steps([1.0, 2.0, 3.0, last])


@pytest.mark.parametrize("period", [0.1, 0.4, 0.5, 0.9, 1.1, 1.4, 2.0, 3.0, 4.0, 5.0, 10.0, 20.0])
def test_when_the_rate_is_another_one_expect_a_refusal_within_a_second(period: float) -> None:
    with pytest.raises(MalformedMessageError, match="update_rate"):
        steps([period * i for i in range(round(1000 / period))])


@pytest.mark.parametrize(
    ("jump", "words"),
    [
        (0.011, "once a millisecond"),
        (3600.0, "by [+]3600 s.* the clock of the rig was set"),
        (-20.0, "by -20 s.* the clock of the rig was set"),
        (1.7e9, "the clock of the rig was set"),
    ],
)
def test_when_the_clock_is_set_expect_a_refusal_at_once(jump: float, words: str) -> None:
    with pytest.raises(MalformedMessageError, match=words):
        steps([3e4, 3e4 + 1.0, 3e4 + 2.0, 3e4 + 2.0 + 1e3 * jump])
