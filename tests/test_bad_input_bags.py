"""Bags of every wrong kind, through the commands that take them: a result, or a clear complaint."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from armimp_common import topics
from support.bag_files import STORE, write_bag, write_foreign
from support.command import refused
from support.synthetic_bags import Message, recorded_arm

SAMPLES = 1800
MESSAGES = recorded_arm(SAMPLES).messages
NAMES = recorded_arm(SAMPLES).records[0].joint_names
TYPES = dict(topics.MESSAGE_TYPES)


def write(path: Path, messages: Sequence[Message] = MESSAGES, **metadata: str) -> Path:
    return write_bag(path, messages, metadata)


def foreign(path: Path, messages: Sequence[Message], types: dict[str, str] = TYPES) -> Path:
    """As ``ros2 bag record`` would have it, with whatever types."""
    return write_foreign(path, (("/" + m[0], types[m[0]], *m[1:]) for m in messages))


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("good") / "bag", joint_names=json.dumps(NAMES))


def both_refuse(bag: Path) -> str:
    """The line with which both commands refuse a bag, as data that are invalid."""
    lines = set()
    for command in ("estimate", "replay"):
        told = refused(command, str(bag))
        assert told.status == 1
        lines.add(told.err)
    (line,) = lines
    assert str(bag) in line
    return line


class TestContent:
    def test_foreign_topics(self, tmp_path: Path) -> None:
        raw = STORE.serialize_cdr(
            STORE.types["std_msgs/msg/String"](data="hello"), "std_msgs/msg/String"
        )
        bag = foreign(
            tmp_path / "bag",
            [("chatter", 10**9 + i, bytes(raw)) for i in range(20)],
            {"chatter": "std_msgs/msg/String"},
        )
        assert "no messages of an experiment in it" in both_refuse(bag)

    @pytest.mark.parametrize(
        "kind", ["std_msgs/msg/Float64MultiArray", "std_msgs/msg/String", "sensor_msgs/msg/Imu"]
    )
    def test_a_wrong_message_type(self, kind: str, tmp_path: Path) -> None:
        bag = foreign(tmp_path / "bag", MESSAGES, {**TYPES, topics.JOINT_STATES: kind})
        line = both_refuse(bag)
        assert kind in line
        assert topics.JOINT_STATES in line


class TestFiles:
    def test_one_bad_bag_among_good_ones_is_named(self, good: Path, tmp_path: Path) -> None:
        (tmp_path / "empty.mcap").touch()
        told = refused("estimate", str(good), str(tmp_path / "empty.mcap"))
        assert f"{tmp_path / 'empty.mcap'}: is empty" in told.err

    def test_bags_of_other_joints_do_not_mix(self, good: Path, tmp_path: Path) -> None:
        other = [(t, n, raw.replace(b"joint_", b"whale_")) for t, n, raw in MESSAGES]
        told = refused("estimate", str(good), str(write(tmp_path / "other", other)))
        assert "joints whale_1, whale_2 differ from joint_1, joint_2" in told.err
