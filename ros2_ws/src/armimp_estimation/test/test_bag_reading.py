"""Reading of bags: all storages, names of topics, messages of others, and what is refused."""

import shutil
import sqlite3
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from armimp_common.cdr import JointStateEncoder
from armimp_common.errors import BagError, DataError
from armimp_common.topics import (
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    TRIAL,
    VALUE_FIELD,
)
from armimp_estimation.bags.metadata_yaml import dump
from armimp_estimation.bags.raw import absolute
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.problems import ProblemCode, Severity
from armimp_estimation.record import TrialRecord
from support.bag_files import (
    iterate_messages,
    records_of,
    typed,
    write_bag,
    write_foreign,
    write_mcap,
)
from support.synthetic_bags import Message, assert_same, synthetic_recording

RECORDING = synthetic_recording(perturbed=(0, 1), ticks=120, settle=30, rest=20)
METADATA = {"schema": "1", "seed": "1", "joint_names": '["shoulder", "elbow"]'}
write_others = partial(write_foreign, storage=StoragePlugin.SQLITE3, metadata=METADATA)


def assert_reads(path: Path) -> None:
    content = read_bag(path)
    records = records_of(content)
    assert len(records) == len(RECORDING.records)
    for record, wanted in zip(records, RECORDING.records, strict=True):
        assert_same(record, wanted)
    for trial in content.trials:
        assert trial.window.seed == 1
        assert trial.statistics.lost == 0
    assert content.notes == ()
    assert list(content.messages()) == list(RECORDING.messages)
    assert list(iterate_messages(path)) == list(RECORDING.messages)


def refusal(path: Path, *, namespace: str | None = None) -> str:
    """The line with which reading or estimating the bag is refused."""
    with pytest.raises((BagError, DataError)) as error:
        records_of(read_bag(path, namespace=namespace))
    text = str(error.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def resent(
    record: TrialRecord, order: Callable[[int], Sequence[str]], moved: float = 0.0
) -> list[Message]:
    """Messages of a trial, whose joints are in the order that is given for each tick.

    Joints that are not of the trial move by a share `moved` of the perturbed one.
    """
    rows = {name: row for row, name in enumerate(record.joint_names)}
    fields = ((JOINT_STATES, record.position), (TORQUE_SENSORS, record.torque))
    other = 0.1 + moved * record.position[record.perturbed_joint]
    messages: list[Message] = []
    for tick in range(record.samples):
        stamp, names = record.start_ns + tick * PERIOD_NS, order(tick)
        for topic, values in (*fields, (PERTURBATION, record.perturbation)):
            told = [name for name in names if name in rows or topic == JOINT_STATES]
            numbers = [values[rows[name], tick] if name in rows else other[tick] for name in told]
            encode = JointStateEncoder(told, VALUE_FIELD[topic]).encode
            messages.append((topic, stamp, encode(stamp, numbers)))
    return messages


class TestStorages:
    def test_metadata_yaml_itself_stands_for_its_bag(self, tmp_path: Path) -> None:
        assert_reads(write_bag(tmp_path / "bag", RECORDING.messages, METADATA) / "metadata.yaml")

    @pytest.mark.parametrize("version", [8, 9])
    @pytest.mark.parametrize(
        ("storage", "mode"),
        [
            one
            for one in product(StoragePlugin, CompressionMode)
            # SQLite compresses nothing by itself.
            if one != (StoragePlugin.SQLITE3, CompressionMode.STORAGE)
        ],
    )
    @pytest.mark.parametrize("with_metadata", [True, False])
    def test_foreign_bag_is_read_whatever_its_storage(
        self,
        tmp_path: Path,
        storage: StoragePlugin,
        mode: CompressionMode,
        version: int,
        with_metadata: bool,
    ) -> None:
        messages = typed(RECORDING.messages)
        path = write_others(tmp_path / "bag", messages, storage=storage, mode=mode, version=version)
        if not with_metadata:
            (path / "metadata.yaml").unlink()
        assert_reads(path)

    @pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
    @pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE])
    def test_bare_file_is_read(
        self, tmp_path: Path, storage: StoragePlugin, mode: CompressionMode
    ) -> None:
        messages = typed(RECORDING.messages)
        path = write_others(tmp_path / "bag", messages, storage=storage, mode=mode)
        (file,) = (entry for entry in path.iterdir() if entry.name != "metadata.yaml")
        assert_reads(file.rename(tmp_path / "any name#?%"))

    @pytest.mark.parametrize("compression", CompressionType)
    def test_mcap_without_any_index_is_read(
        self, tmp_path: Path, compression: CompressionType
    ) -> None:
        assert_reads(write_mcap(tmp_path / "bag.mcap", RECORDING.messages, compression=compression))
        assert_reads(write_mcap(tmp_path / "plain.mcap", RECORDING.messages, chunking=False))

    def test_split_bag_is_read_in_the_order_of_its_times(self, tmp_path: Path) -> None:
        path = tmp_path / "bag"
        half = len(RECORDING.messages) // 2
        write_others(path, typed(RECORDING.messages[:half]))
        write_others(tmp_path / "more", typed(RECORDING.messages[half:]))
        # Numbered so that the order of the names is not that of the numbers.
        (path / "bag.db3").rename(path / "bag_9.db3")
        (tmp_path / "more" / "more.db3").rename(path / "bag_10.db3")
        (path / "metadata.yaml").unlink()
        assert_reads(path)

    def test_sqlite_with_a_write_ahead_log_is_read_to_its_end(self, tmp_path: Path) -> None:
        path = write_others(tmp_path / "bag", typed(RECORDING.messages[:-300]))
        database = sqlite3.connect(path / "bag.db3")
        database.execute("PRAGMA journal_mode=WAL")
        topics = dict(database.execute("SELECT name, id FROM topics"))
        database.executemany(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
            [(topics[absolute(t)], time, raw) for t, time, raw in RECORDING.messages[-300:]],
        )
        database.commit()
        # What a killed recorder leaves behind: the log was never merged.
        copy = tmp_path / "copy"
        shutil.copytree(path, copy)
        database.close()
        assert (copy / "bag.db3-wal").stat().st_size > 0
        before = {entry.name: entry.stat().st_mtime_ns for entry in copy.iterdir()}
        assert_reads(copy)
        assert {entry.name: entry.stat().st_mtime_ns for entry in copy.iterdir()} == before


class TestTopics:
    @pytest.mark.parametrize("prefix", ["/rig", "/lab/rig_2"])
    def test_namespace_is_found(self, tmp_path: Path, prefix: str) -> None:
        path = write_foreign(tmp_path / "bag", typed(RECORDING.messages, prefix))
        assert_reads(path)
        assert read_bag(path).topics[TRIAL] == f"{prefix}/imbic_controller/trial"

    def test_two_rigs_need_a_choice(self, tmp_path: Path) -> None:
        other = synthetic_recording(ticks=20, seed=5)
        both = (*typed(RECORDING.messages), *typed(other.messages, "/left"))
        path = write_foreign(tmp_path / "bag", both)
        assert refusal(path) == (
            f"{path}: holds the topics of several rigs, choose a namespace: /, /left"
        )
        with pytest.raises(BagError, match="choose a namespace"):
            iterate_messages(path)
        assert_same(records_of(read_bag(path, namespace="left"))[0], other.records[0])
        assert_same(records_of(read_bag(path, namespace="/"))[0], RECORDING.records[0])
        assert list(iterate_messages(path, namespace="/left/")) == list(other.messages)
        assert "has no joint positions" in refusal(path, namespace="right")

    def test_needed_topics_decide_between_namesakes(self, tmp_path: Path) -> None:
        stray = (JOINT_STATES, 2**40, b"\0\1\0\0 not of this rig")
        messages = (*typed(RECORDING.messages, "/rig"), *typed([stray]))
        assert_reads(write_foreign(tmp_path / "bag", messages))

    def test_other_type_is_named(self, tmp_path: Path) -> None:
        kinds = {absolute(JOINT_STATES): "std_msgs/msg/String"}
        messages = ((m[0], kinds.get(m[0], m[1]), *m[2:]) for m in typed(RECORDING.messages))
        path = write_foreign(tmp_path / "bag", messages)
        assert "joint_states is of type std_msgs/msg/String" in refusal(path)

    def test_other_encoding_is_named(self, tmp_path: Path) -> None:
        path = write_mcap(tmp_path / "bag.mcap", RECORDING.messages, encoding="json")
        assert refusal(path) == (
            f"{path}: topic /imbic_controller/trial is encoded as 'json', not as cdr"
        )


class TestForeignMessages:
    def test_joint_order_may_differ_per_message(self, tmp_path: Path) -> None:
        (record,) = synthetic_recording(ticks=60).records
        messages = resent(record, lambda tick: record.joint_names[:: 1 if tick % 3 else -1])
        path = write_bag(tmp_path / "bag", messages, METADATA)
        assert_same(records_of(read_bag(path))[0], record)

    @pytest.mark.parametrize("moved", [0.0, 0.1])
    def test_further_joints_in_messages_of_sensors_are_passed_over_unless_they_move(
        self, tmp_path: Path, moved: float
    ) -> None:
        record = RECORDING.records[0]
        messages = resent(record, lambda _: ("grip", *record.joint_names), moved)
        content = read_bag(write_bag(tmp_path / "bag", messages, METADATA))
        np.testing.assert_array_equal(content.trials[0].segments[0].position, record.position)
        (note,) = content.notes
        assert "joint_states has joints that were passed over, grip:" in note
        for found in content.trials[0].problems:
            assert found.code is ProblemCode.FURTHER_JOINT_MOVED
            assert (found.severity, found.values["name"]) == (Severity.ERROR, "grip")
            assert found.values["percent"] == pytest.approx(100.0 * moved)
        assert len(content.trials[0].problems) == (moved > 0.0)

    def test_order_of_the_metadata_prevails(self, tmp_path: Path) -> None:
        metadata = {"joint_names": '["elbow", "shoulder"]'}
        content = read_bag(write_bag(tmp_path / "bag", RECORDING.messages, metadata))
        assert content.joint_names == ("elbow", "shoulder")
        assert [record.perturbed_joint for record in records_of(content)] == [1, 0]
        np.testing.assert_array_equal(
            records_of(content)[0].position, RECORDING.records[0].position[::-1]
        )


class TestRefusals:
    @pytest.mark.parametrize(
        ("name", "content", "reason"),
        [
            ("notes.mcap", b"This is a text about bags.", "is neither an MCAP nor an SQLite3 file"),
            ("bag.mcap.zstd", zstandard.compress(b"x"), "is neither an MCAP nor an SQLite3 file"),
            ("old.bag", b"#ROSBAG V2.0\n", "is a ROS 1 bag; convert it with rosbags-convert"),
            ("bag.db3", b"", "is empty"),
        ],
    )
    def test_file_of_something_else(
        self, tmp_path: Path, name: str, content: bytes, reason: str
    ) -> None:
        path = tmp_path / name
        path.write_bytes(content)
        assert refusal(path) == f"{path}: {reason}"

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("", "not the metadata of a bag"),
            ("\udcff\udcfe", "not the metadata of a bag: 'utf-8' codec"),
            ("a: [", "not the metadata of a bag: while parsing"),
            ("rosbag2_bagfile_information:\n  version: 9", "lists no storage files"),
            (
                "rosbag2_bagfile_information:\n  relative_file_paths: [[a]]",
                "not the metadata of a bag: rosbag2_bagfile_information.relative_file_paths.0: ",
            ),
            ("rosbag2_bagfile_information: &a {relative_file_paths: *a}", "not the metadata of"),
            ("[" * 100_000, "not the metadata of a bag: "),
        ],
    )
    def test_broken_metadata(self, tmp_path: Path, text: str, reason: str) -> None:
        path = write_bag(tmp_path / "bag", RECORDING.messages, METADATA)
        (path / "metadata.yaml").write_bytes(text.encode(errors="surrogateescape"))
        assert refusal(path).startswith(f"{path / 'metadata.yaml'}: {reason}")

    @pytest.mark.parametrize("name", ["nowhere.mcap", "..", "a\0b"])
    def test_storage_file_that_is_missing(self, tmp_path: Path, name: str) -> None:
        path = write_bag(tmp_path / "bag", RECORDING.messages, METADATA)
        listed = {"relative_file_paths": [name]}
        (path / "metadata.yaml").write_text(dump({"rosbag2_bagfile_information": listed}))
        assert refusal(path).endswith(": is missing, though listed in metadata.yaml")

    def test_recording_of_something_else(self, tmp_path: Path) -> None:
        chatter = [("/chatter", "std_msgs/msg/String", 1, b"\0\1\0\0\1\0\0\0\0")]
        path = write_foreign(tmp_path / "bag", chatter)
        assert refusal(path) == f"{path}: no messages of an experiment in it"

    def test_recording_that_ends_before_the_perturbation(self, tmp_path: Path) -> None:
        path = write_bag(tmp_path / "bag", RECORDING.messages[:80], METADATA)
        assert refusal(path) == (
            f"{path}: no trial in it; the last status is: "
            "trial 1 of 2: settling before the perturbation of joint 1 (shoulder)"
        )


def test_damaged_status_is_noted(tmp_path: Path) -> None:
    recording = synthetic_recording(ticks=50)
    topic, time, raw = recording.messages[-1]
    assert topic == TRIAL
    messages = (*recording.messages[:-1], (topic, time, raw[:40]))
    path = write_bag(tmp_path / "bag", messages, METADATA)
    content = read_bag(path)
    assert_same(records_of(content)[0], recording.records[0])
    (note,) = content.notes
    assert note.startswith(f"{path}: damaged messages of {TRIAL}: DiagnosticStatus")
