"""Bags of a wrong kind through the commands that take them: one line with file and cause."""

from pathlib import Path

import pytest

from armimp_common import topics
from support.bag_files import write_bag, write_foreign
from support.command import refused
from support.synthetic_bags import recorded_arm

MESSAGES = recorded_arm(1800).messages
TYPES = dict(topics.MESSAGE_TYPES)


@pytest.mark.parametrize("command", ["estimate", "replay"])
@pytest.mark.parametrize(
    ("topic", "kind", "reason"),
    [
        ("chatter", "sensor_msgs/msg/JointState", "has no joint positions"),
        (topics.JOINT_STATES, "std_msgs/msg/String", "joint_states is of type std_msgs/msg/String"),
    ],
)
def test_when_topic_or_type_is_wrong_expect_both_commands_to_name_it(
    command: str, topic: str, kind: str, reason: str, tmp_path: Path
) -> None:
    others = {
        **{name: (name, kind) for name, kind in TYPES.items()},
        topics.JOINT_STATES: (topic, kind),
    }
    path = write_foreign(
        tmp_path / "bag", (("/" + others[m[0]][0], others[m[0]][1], *m[1:]) for m in MESSAGES)
    )
    told = refused(command, str(path))
    assert told.status == 1
    assert told.err.startswith(f"armimp: {path}: ")
    assert reason in told.err


def test_one_bad_bag_among_good_ones_is_named(tmp_path: Path) -> None:
    good = write_bag(tmp_path / "good", MESSAGES, {})
    (tmp_path / "empty.mcap").touch()
    told = refused("estimate", str(good), str(tmp_path / "empty.mcap"))
    assert f"{tmp_path / 'empty.mcap'}: is empty" in told.err
    others = [(t, n, raw.replace(b"joint_", b"whale_")) for t, n, raw in MESSAGES]
    told = refused("estimate", str(good), str(write_bag(tmp_path / "other", others, {})))
    assert "joints whale_1, whale_2 differ from joint_1, joint_2" in told.err
