"""Bags of every wrong kind, through the commands that take them: a result, or a clear complaint."""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from armimp_common import topics
from armimp_common.cdr import JointStateDecoder, JointStateEncoder
from armimp_common.topics import PERIOD_NS
from support.bag_files import STORE, write_bag, write_foreign
from support.command import Told, behaved, call, refused
from support.synthetic_bags import Message, recorded_arm

SAMPLES = 1800
MESSAGES = recorded_arm(SAMPLES).messages
NAMES = recorded_arm(SAMPLES).records[0].joint_names
TYPES = dict(topics.MESSAGE_TYPES)
Change = Callable[[Message], Message | None]


def write(path: Path, messages: Sequence[Message] = MESSAGES, **metadata: str) -> Path:
    return write_bag(path, messages, metadata)


def foreign(path: Path, messages: Sequence[Message], types: dict[str, str] = TYPES) -> Path:
    """As ``ros2 bag record`` would have it, with whatever types."""
    return write_foreign(path, (("/" + m[0], types[m[0]], *m[1:]) for m in messages))


def changed(change: Change) -> list[Message]:
    return [kept for message in MESSAGES if (kept := change(message)) is not None]


def restamped(stamp: Callable[[int], int], names: Sequence[str] = NAMES) -> list[Message]:
    """All samples with other stamps, and the joints in another order."""

    fields = topics.VALUE_FIELD.items()
    decode = {topic: JointStateDecoder(names, field).decode for topic, field in fields}
    encode = {topic: JointStateEncoder(names, field).encode for topic, field in fields}

    def change(message: Message) -> Message:
        topic, log_time_ns, raw = message
        if topic not in decode:
            return message
        stamp_ns, values = decode[topic](raw)
        return topic, log_time_ns, encode[topic](stamp(stamp_ns), values)

    return changed(change)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("good") / "bag", joint_names=json.dumps(NAMES))


@pytest.fixture(scope="module")
def told_of_good(good: Path) -> Told:
    told = behaved("estimate", str(good), "--json")
    assert told.status == 0
    return told


def numbers(told: Told) -> object:
    return json.loads(told.out)["estimators"]


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

    def test_no_messages(self, tmp_path: Path) -> None:
        assert "no messages of an experiment" in both_refuse(write(tmp_path / "own", ()))
        assert "no messages of an experiment" in both_refuse(foreign(tmp_path / "foreign", ()))

    @pytest.mark.parametrize(
        "topic", [topics.JOINT_STATES, topics.TORQUE_SENSORS, topics.PERTURBATION]
    )
    def test_a_missing_topic(self, topic: str, tmp_path: Path) -> None:
        bag = foreign(tmp_path / "bag", changed(lambda m: None if m[0] == topic else m))
        assert f"no topic {topic}" in both_refuse(bag)

    @pytest.mark.parametrize("topic", [topics.JOINT_STATES, topics.TORQUE_SENSORS])
    def test_wrong_joint_names(self, topic: str, tmp_path: Path) -> None:
        def rename(message: Message) -> Message:
            raw = message[2].replace(b"joint_2", b"joint_7") if message[0] == topic else message[2]
            return message[0], message[1], raw

        line = both_refuse(foreign(tmp_path / "bag", changed(rename)))
        assert f"{topic}: none of " in line
        assert "'joint_7'" in line

    def test_another_order_of_the_joints_gives_the_same_numbers(
        self, tmp_path: Path, told_of_good: Told
    ) -> None:
        bag = write(
            tmp_path / "bag",
            restamped(lambda stamp: stamp, NAMES[::-1]),
            joint_names=json.dumps(NAMES),
        )
        assert numbers(behaved("estimate", str(bag), "--json")) == numbers(told_of_good)

    @pytest.mark.parametrize(
        "kind", ["std_msgs/msg/Float64MultiArray", "std_msgs/msg/String", "sensor_msgs/msg/Imu"]
    )
    def test_a_wrong_message_type(self, kind: str, tmp_path: Path) -> None:
        bag = foreign(tmp_path / "bag", MESSAGES, {**TYPES, topics.JOINT_STATES: kind})
        line = both_refuse(bag)
        assert kind in line
        assert topics.JOINT_STATES in line

    def test_messages_of_another_type_under_the_right_name(self, tmp_path: Path) -> None:
        command = next(raw for topic, _, raw in MESSAGES if topic == topics.COMMANDS)
        bag = write(
            tmp_path / "bag",
            changed(lambda m: (m[0], m[1], command) if m[0] == topics.TORQUE_SENSORS else m),
        )
        assert f"{topics.TORQUE_SENSORS}: none of " in both_refuse(bag)

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("topic", [topics.JOINT_STATES, topics.TORQUE_SENSORS])
    def test_a_value_that_is_no_number(self, topic: str, value: float, tmp_path: Path) -> None:
        numbered = [i for i, message in enumerate(MESSAGES) if message[0] == topic]
        where = numbered[len(numbered) // 4]
        encoder = JointStateEncoder(NAMES, topics.VALUE_FIELD[topic])
        stamp_ns = MESSAGES[where][1]
        messages = list(MESSAGES)
        messages[where] = (topic, stamp_ns, encoder.encode(stamp_ns, np.array([0.1, value])))
        line = both_refuse(write(tmp_path / "bag", messages))
        assert f"trial 1: samples of {topic} are not finite: 1" in line


class TestStamps:
    @pytest.mark.parametrize(
        "stamp",
        [
            lambda stamp: stamp // 2,
            lambda stamp: 5 * 10**9,
            lambda stamp: 10**12 - stamp,
            lambda stamp: stamp + (stamp // PERIOD_NS % 7) * 300_000,
        ],
        ids=["twice the rate", "all the same", "backwards", "jitter"],
    )
    def test_wrong_stamps_are_refused(self, stamp: Callable[[int], int], tmp_path: Path) -> None:
        both_refuse(write(tmp_path / "bag", restamped(stamp)))

    def test_a_rate_that_the_controller_did_not_plan_is_named(self, tmp_path: Path) -> None:
        told = call("estimate", str(write(tmp_path / "bag", restamped(lambda stamp: 2 * stamp))))
        assert told.status == 1
        assert "a sampling rate of 500 Hz, but 1000 Hz were expected" in told.err

    def test_swapped_samples_are_found_by_their_stamps(
        self, tmp_path: Path, told_of_good: Told
    ) -> None:
        def swapped(stamp: int) -> int:
            tick = stamp // PERIOD_NS
            return PERIOD_NS * (tick + 1 - 2 * (tick % 2) if 200 <= tick < 210 else tick)

        bag = write(tmp_path / "bag", restamped(swapped))
        told = behaved("estimate", str(bag), "--json")
        assert told.status == 1 or numbers(told) != numbers(told_of_good)


def test_trust_lifts_the_limits_and_changes_no_number(
    good: Path, told_of_good: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armimp_estimation.bags.raw._FREE", 0)
    monkeypatch.setattr("armimp_estimation.bags.raw._RATIO", 1)
    assert "--trust lifts the limits" in both_refuse(good)
    assert numbers(behaved("estimate", str(good), "--trust", "--json")) == numbers(told_of_good)


class TestContradictions:
    """Two messages with one stamp, the torques of the first being twice those of the second."""

    @staticmethod
    def doubled(path: Path, ticks: range) -> Path:
        stamps = {1_000_000 * tick for tick in ticks}
        decoder = JointStateDecoder(NAMES, "effort")
        encoder = JointStateEncoder(NAMES, "effort")
        messages: list[Message] = []
        for topic, log_time_ns, raw in MESSAGES:
            if topic == topics.TORQUE_SENSORS and log_time_ns in stamps:
                stamp_ns, values = decoder.decode(raw)
                twice = encoder.encode(stamp_ns, [2.0 * value for value in values])
                messages.append((topic, log_time_ns, twice))
            messages.append((topic, log_time_ns, raw))
        return write(path, messages)

    def test_some_are_left_out_like_gaps(self, tmp_path: Path) -> None:
        ticks = range(700, 730)
        contradictory = self.doubled(tmp_path / "bag", ticks)
        assert "samples of torque_sensors contradict themselves: 30" in both_refuse(contradictory)
        lost = write(
            tmp_path / "lost",
            changed(
                lambda m: (
                    None if m[0] == topics.TORQUE_SENSORS and m[1] // PERIOD_NS in ticks else m
                )
            ),
        )
        told = behaved("estimate", str(contradictory), "--allow-gaps", "--json")
        assert numbers(told) == numbers(behaved("estimate", str(lost), "--allow-gaps", "--json"))
        trial = json.loads(told.out)["trials"][0]
        assert trial["streams"][topics.TORQUE_SENSORS]["contradictory"] == 30
        assert trial["excluded"] == 30

    def test_where_all_are_there_is_no_result(self, tmp_path: Path) -> None:
        bag = self.doubled(tmp_path / "bag", range(10_000))
        told = refused("estimate", str(bag), "--allow-gaps")
        assert told.status == 1
        assert "contradict themselves" in told.err


class TestMetadata:
    @pytest.mark.parametrize(
        ("key", "value", "complaint"),
        [
            ("config", "[" * 100_000, "config is not JSON: '[["),
            ("truth", '{"M": [[1]], "B": [[1]], "K": [[1]]}', "truth is of 1 joints, the data of"),
            ("joint_names", '["joint_1\\n", "joint_2"]', r"lacks joint 'joint_1\n'"),
        ],
    )
    def test_wrong_metadata_are_named(
        self, key: str, value: str, complaint: str, tmp_path: Path
    ) -> None:
        assert complaint in both_refuse(write(tmp_path / "bag", MESSAGES, **{key: value}))

    @pytest.mark.parametrize("timing", ["x", "5", "[]", "null", "[" * 100_000])
    def test_a_wrong_torque_timing_makes_the_result_invalid(
        self, timing: str, tmp_path: Path
    ) -> None:
        bag = write(tmp_path / "bag", MESSAGES, torque_timing=timing)
        told = behaved("estimate", str(bag))
        assert told.status == 1
        (line,) = told.complaints
        assert "torque_timing" in line

    @pytest.mark.parametrize(
        ("key", "value"),
        [("config", '{"experiment": 5}'), ("seed", "[]"), ("seed", "null"), ("truth", "null")],
    )
    def test_metadata_of_no_consequence_do_no_harm(
        self, key: str, value: str, tmp_path: Path, told_of_good: Told
    ) -> None:
        bag = write(tmp_path / "bag", MESSAGES, **{key: value})
        assert numbers(behaved("estimate", str(bag), "--json")) == numbers(told_of_good)

    def test_garbage_as_metadata_file_is_named(self, good: Path, tmp_path: Path) -> None:
        bag = Path(shutil.copytree(good, tmp_path / "bag"))
        (bag / "metadata.yaml").write_bytes(bytes(range(256)))
        both_refuse(bag)

    def test_a_directory_as_metadata_file_is_named(self, good: Path, tmp_path: Path) -> None:
        bag = Path(shutil.copytree(good, tmp_path / "bag"))
        (bag / "metadata.yaml").unlink()
        (bag / "metadata.yaml").mkdir()
        assert "metadata.yaml: cannot be read: Is a directory" in both_refuse(bag)


class TestFiles:
    @pytest.mark.parametrize("name", ["bag", "bag.mcap", "bag.db3", "metadata.yaml"])
    def test_a_file_of_length_zero(self, name: str, tmp_path: Path) -> None:
        (tmp_path / name).touch()
        for command in ("estimate", "replay"):
            assert str(tmp_path) in refused(command, str(tmp_path / name)).err

    def test_a_directory_without_files(self, tmp_path: Path) -> None:
        assert "is an empty directory" in both_refuse(tmp_path)

    def test_a_directory_of_other_files(self, tmp_path: Path) -> None:
        (tmp_path / "thesis.tex").write_text("ten years of work")
        assert "is not a bag: it has no metadata.yaml" in both_refuse(tmp_path)

    @pytest.mark.parametrize("name", ["/dev/null", "/dev/full", "/proc/self/mem", "a" * 300])
    def test_what_cannot_be_read(self, name: str) -> None:
        both_refuse(Path(name))

    def test_one_bad_bag_among_good_ones_is_named(self, good: Path, tmp_path: Path) -> None:
        (tmp_path / "empty.mcap").touch()
        told = refused("estimate", str(good), str(tmp_path / "empty.mcap"))
        assert f"{tmp_path / 'empty.mcap'}: is empty" in told.err

    def test_bags_of_other_joints_do_not_mix(self, good: Path, tmp_path: Path) -> None:
        other = [(t, n, raw.replace(b"joint_", b"whale_")) for t, n, raw in MESSAGES]
        told = refused("estimate", str(good), str(write(tmp_path / "other", other)))
        assert "joints whale_1, whale_2 differ from joint_1, joint_2" in told.err


def storage(bag: Path) -> bytes:
    (file,) = bag.glob("*.mcap")
    return file.read_bytes()


def test_a_cut_bag_is_refused_by_replay_with_the_same_reason(good: Path, tmp_path: Path) -> None:
    whole = storage(good)
    file = tmp_path / "cut.mcap"
    for size in (5, 100, 3000):
        file.write_bytes(whole[:size])
        both_refuse(file)
