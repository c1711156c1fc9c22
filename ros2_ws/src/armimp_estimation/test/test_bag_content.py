import sqlite3
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import zstandard

from armimp_common import topics
from armimp_common.errors import BagError, DataError
from armimp_common.topics import PERIOD_NS
from armimp_estimation.bags import read_bag
from support.bag_files import STORE, iterate_messages, write_bag
from support.synthetic_bags import Message, assert_same, synthetic_recording

RECORDING = synthetic_recording(perturbed=(0, 1), ticks=120, settle=30, rest=20)


def write(path: Path, messages: Sequence[Message] = RECORDING.messages, **metadata: str) -> Path:
    return write_bag(path, messages, metadata)


def joint_state(
    stamp_ns: int,
    names: Sequence[str],
    *,
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
    little_endian: bool = True,
) -> bytes:
    types = STORE.types
    sec, nanosec = divmod(stamp_ns, 10**9)
    message = types["sensor_msgs/msg/JointState"](
        header=types["std_msgs/msg/Header"](
            stamp=types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec),
            frame_id="world",
        ),
        name=list(names),
        position=np.array(position, np.float64),
        velocity=np.array(velocity, np.float64),
        effort=np.array(effort, np.float64),
    )
    data = STORE.serialize_cdr(message, "sensor_msgs/msg/JointState", little_endian=little_endian)
    return bytes(data)


def error_of(path: Path) -> str:
    """The line with which reading or estimating the bag is refused."""
    with pytest.raises((BagError, DataError)) as error:
        read_bag(path).records()
    text = str(error.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def without(topic: str) -> list[Message]:
    return [message for message in RECORDING.messages if message[0] != topic]


class TestForeignMessages:
    @pytest.mark.parametrize("little_endian", [True, False])
    def test_joint_order_and_filled_arrays_may_differ_per_message(
        self, tmp_path: Path, little_endian: bool
    ) -> None:
        (record,) = synthetic_recording(ticks=60).records
        names = record.joint_names
        messages: list[Message] = []
        for tick in range(record.samples):
            stamp = record.start_ns + tick * PERIOD_NS
            order = [1, 0] if tick % 3 else [0, 1]
            named = [names[k] for k in order]
            for topic, values, filled in (
                (topics.JOINT_STATES, record.position, {"velocity": (1, 2), "effort": (3, 4)}),
                (topics.TORQUE_SENSORS, record.torque, {"position": (5, 6)}),
                (topics.PERTURBATION, record.perturbation, {}),
            ):
                field = topics.VALUE_FIELD[topic]
                raw = joint_state(
                    stamp,
                    named,
                    little_endian=little_endian,
                    **{field: values[order, tick].tolist()},
                    **filled,
                )
                messages.append((topic, stamp, raw))
        path = write(tmp_path / "bag", messages)
        assert_same(read_bag(path).records()[0], record)

    def test_order_of_the_controller_is_taken_without_metadata(self, tmp_path: Path) -> None:
        path = write(tmp_path / "bag")
        assert read_bag(path).joint_names == ("shoulder", "elbow")

    def test_order_of_the_metadata_prevails(self, tmp_path: Path) -> None:
        path = write(tmp_path / "bag", joint_names='["elbow", "shoulder"]')
        content = read_bag(path)
        assert content.joint_names == ("elbow", "shoulder")
        assert [record.perturbed_joint for record in content.records()] == [1, 0]
        np.testing.assert_array_equal(
            content.records()[0].position, RECORDING.records[0].position[::-1]
        )

    @pytest.mark.parametrize("text", ["", "[", "3", "[]", "[1]", "[" * 100_000])
    def test_nonsense_in_metadata_is_passed_over(self, tmp_path: Path, text: str) -> None:
        path = write(tmp_path / "bag", joint_names=text)
        assert read_bag(path).joint_names == ("shoulder", "elbow")

    def test_commands_are_not_needed(self, tmp_path: Path) -> None:
        path = write(tmp_path / "bag", without(topics.COMMANDS))
        content = read_bag(path)
        assert_same(content.records()[1], RECORDING.records[1])
        assert content.trials[0].statistics.streams[topics.COMMANDS].lost == 120

    def test_trials_are_inferred_without_statuses(self, tmp_path: Path) -> None:
        recording = synthetic_recording(perturbed=(1, 0, 0), ticks=80, settle=200, rest=100)
        messages = [message for message in recording.messages if message[0] != topics.TRIAL]
        path = write(tmp_path / "bag", messages)
        records = read_bag(path).records()
        assert len(records) == 3
        for record, expected in zip(records, recording.records, strict=True):
            assert_same(record, expected)
            assert record.seed is None


class TestReplay:
    def test_messages_of_any_content_can_be_iterated(self, tmp_path: Path) -> None:
        messages = [(topics.CLOCK, 3, b"\0\1\0\0a"), (topics.DIAGNOSTICS, 4, b"\0\1\0\0b")]
        path = write(tmp_path / "bag", messages)
        assert list(iterate_messages(path)) == messages

    def test_bag_is_checked_before_the_first_message_is_asked_for(self, tmp_path: Path) -> None:
        with pytest.raises(BagError):
            iterate_messages(tmp_path / "nowhere")


class TestRefusals:
    def test_missing_path(self, tmp_path: Path) -> None:
        path = tmp_path / "nowhere"
        assert error_of(path) == f"{path}: does not exist"

    @pytest.mark.parametrize(
        ("name", "content", "reason"),
        [
            ("notes.mcap", b"This is a text about bags.", "is neither an MCAP nor an SQLite3 file"),
            (
                "bag.mcap.zstd",
                zstandard.compress(b"x"),
                "is neither an MCAP nor an SQLite3 file",
            ),
            ("old.bag", b"#ROSBAG V2.0\n", "is a ROS 1 bag; convert it with rosbags-convert"),
            ("bag.db3", b"", "is empty"),
        ],
    )
    def test_file_of_something_else(
        self, tmp_path: Path, name: str, content: bytes, reason: str
    ) -> None:
        path = tmp_path / name
        path.write_bytes(content)
        assert error_of(path) == f"{path}: {reason}"

    def test_directory_of_bags_is_told_from_a_bag(self, tmp_path: Path) -> None:
        write(tmp_path / "trial_1")
        write(tmp_path / "trial_2")
        assert error_of(tmp_path) == (f"{tmp_path}: is not a bag but holds 2, trial_1 for one")

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("", "not the metadata of a bag"),
            ("\udcff\udcfe", "cannot be read: not UTF-8 text"),
            ("a: [", "not valid YAML: "),
            ("just words", "not the metadata of a bag"),
            ("- 1\n- 2\n", "not the metadata of a bag"),
            ("rosbag2_bagfile_information: 7", "not the metadata of a bag"),
            ("rosbag2_bagfile_information:\n  version: 9", "lists no storage files"),
            (
                "rosbag2_bagfile_information:\n  relative_file_paths: [[a]]",
                "lists no storage files",
            ),
            ("[" * 20_000, "not valid YAML"),
            ("a: \0", "not valid YAML"),
            ("*nowhere", "not valid YAML"),
        ],
    )
    def test_broken_metadata(self, tmp_path: Path, text: str, reason: str) -> None:
        path = write(tmp_path / "bag")
        (path / "metadata.yaml").write_bytes(text.encode(errors="surrogateescape"))
        assert error_of(path).startswith(f"{path / 'metadata.yaml'}: {reason}")

    def test_storage_file_that_is_missing(self, tmp_path: Path) -> None:
        path = write(tmp_path / "bag")
        (path / "bag_0.mcap").unlink()
        assert error_of(path) == (
            f"{path / 'bag_0.mcap'}: is missing, though listed in metadata.yaml"
        )

    def test_database_of_something_else(self, tmp_path: Path) -> None:
        path = tmp_path / "other.db3"
        with sqlite3.connect(path) as database:
            database.execute("CREATE TABLE birds(name TEXT)")
        database.close()
        assert error_of(path) == f"{path}: not a readable SQLite3 bag: no plain table topics"

    def test_recording_that_ends_before_the_perturbation(self, tmp_path: Path) -> None:
        path = write(tmp_path / "bag", RECORDING.messages[:80])
        assert error_of(path) == (
            f"{path}: no trial in it; the last status is: "
            "trial 1 of 2: settling before the perturbation of joint 1 (shoulder)"
        )

    def test_perturbation_of_several_joints_without_status(self, tmp_path: Path) -> None:
        messages: list[Message] = []
        for tick in range(20):
            stamp = 10**9 + tick * PERIOD_NS
            raw = joint_state(stamp, ("a", "b"), effort=(0.5, 0.5), position=(1.0, 1.0))
            messages += [(topic, stamp, raw) for topic in topics.VALUE_FIELD]
        path = write(tmp_path / "bag", messages)
        assert "joints 1, 2 are perturbed at once" in error_of(path)


class TestSpoiledTrials:
    def test_other_trials_remain_and_the_error_names_bag_and_trial(self, tmp_path: Path) -> None:
        messages = [
            message
            for number, message in enumerate(RECORDING.messages)
            if number not in (200, 201, 300)
        ]
        path = write(tmp_path / "bag", messages)
        content = read_bag(path)
        assert_same(content.trials[1].intact()[0], RECORDING.records[1])
        assert error_of(path).startswith(f"{path}: trial 1: samples of ")
        with pytest.raises(DataError, match="trial 1: samples of "):
            content.trials[0].intact()

    def test_cut_recording_is_estimated_with_a_note(self, tmp_path: Path) -> None:
        recording = synthetic_recording(ticks=50)
        # The last status and ten periods are missing, and of one more the perturbation.
        path = write(tmp_path / "bag", recording.messages[:-42])
        content = read_bag(path)
        (record,) = content.records()
        assert record.samples == 39
        assert content.notes == (f"{path}: trial 1 is cut short: 39 of 50 samples",)
        assert content.trials[0].shortfall == 11
        assert content.trials[0].statistics.lost == 0

    def test_damaged_status_is_noted(self, tmp_path: Path) -> None:
        recording = synthetic_recording(ticks=50)
        topic, time, raw = recording.messages[-1]
        assert topic == topics.TRIAL
        path = write(tmp_path / "bag", (*recording.messages[:-1], (topic, time, raw[:40])))
        content = read_bag(path)
        assert_same(content.records()[0], recording.records[0])
        (note,) = content.notes
        assert note.startswith(f"{path}: damaged messages of {topics.TRIAL}: DiagnosticStatus")

    def test_metadata_is_plain_text_even_where_yaml_sees_numbers(self, tmp_path: Path) -> None:
        path = write(tmp_path / "bag", schema="1")
        metadata = path / "metadata.yaml"
        text = metadata.read_text()
        assert "schema: '1'" in text
        metadata.write_text(text.replace("schema: '1'", "schema: 12:30"))
        assert read_bag(path).metadata == {"schema": "12:30"}
