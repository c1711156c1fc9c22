import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from armimp_common import topics
from armimp_common.errors import BagError
from armimp_common.topics import CLOCK, DATA_STREAMS, PERIOD_NS, RECORDED, TOPICS, TORQUE_SENSORS
from armimp_estimation.bags.metadata_yaml import FILE_NAME, qos_profiles
from armimp_estimation.bags.raw import absolute
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.bags.writer import (
    FLUSH_INTERVAL_NS,
    BagWriter,
    finish_bag,
    finish_bags,
    require_free_space,
)
from support import known
from support.bag_files import iterate_messages, readable, write_all, write_bag
from support.fault_figures import Figures
from support.places import contents
from support.streams import Topics
from support.synthetic_bags import Message, synthetic_recording

METADATA = {"seed": "7", "joint_names": '["shoulder", "elbow"]', "note": "12:30\nü"}


def one_line(error: pytest.ExceptionInfo[BagError]) -> str:
    text = str(error.value)
    assert "\n" not in text
    return text


def test_mcap_file_has_profile_schemas_channels_and_statistics(tmp_path: Path) -> None:
    messages = synthetic_recording(ticks=300).messages
    path = write_bag(tmp_path / "bag", messages, METADATA)
    with (path / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = known(reader.get_summary())
        records = list(reader.iter_metadata())
        only = [m.data for _, _, m in reader.iter_messages(topics=["/torque_sensors"])]
    statistics = known(summary.statistics)
    assert statistics.message_count == len(messages)
    assert statistics.message_start_time == messages[0][1]
    assert statistics.message_end_time == messages[-1][1]
    assert statistics.chunk_count == len(summary.chunk_indexes) > 1
    schema = next(s for s in summary.schemas.values() if s.name == "sensor_msgs/msg/JointState")
    assert schema.encoding == "ros2msg"
    assert b"MSG: builtin_interfaces/Time\nint32 sec" in schema.data
    topics_by_name = {absolute(topic): topic for topic in RECORDED}
    for channel in summary.channels.values():
        assert channel.message_encoding == "cdr"
        assert set(channel.metadata) == {"offered_qos_profiles", "topic_type_hash"}
        qos = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        assert qos == qos_profiles(topics_by_name[channel.topic])
    assert [(record.name, record.metadata) for record in records] == [("armimp", METADATA)]
    assert only == [raw for topic, _, raw in messages if topic == TORQUE_SENSORS]


class TestRefusals:
    def test_existing_path_is_not_touched(self, tmp_path: Path) -> None:
        path = tmp_path / "bag"
        path.mkdir()
        (path / "precious").write_text("data")
        (tmp_path / "file").write_text("")
        (tmp_path / "link").symlink_to(tmp_path / "nowhere")
        for existing in (path, tmp_path / "file", tmp_path / "link"):
            with pytest.raises(BagError) as error:
                BagWriter(existing, metadata={})
            assert one_line(error) == f"{existing}: exists already, nothing is overwritten"
        assert [entry.name for entry in path.iterdir()] == ["precious"]
        with pytest.raises(BagError, match=r"file/bag: cannot be written: "):
            BagWriter(tmp_path / "file" / "bag", metadata={})

    def test_unknown_topics_and_writing_after_close_are_refused(self, tmp_path: Path) -> None:
        writer = BagWriter(tmp_path / "bag", metadata={})
        attempts = (
            lambda: writer.write("/rosout", b"", 0),
            lambda: writer.write_block([0], {"/rosout": [bytes(4)]}),
        )
        for attempt in attempts:
            with pytest.raises(BagError, match="topic is not recorded: '/rosout'"):
                attempt()
        writer.close()
        writer.close()
        for attempt in attempts:
            with pytest.raises(BagError, match="the bag is closed") as error:
                attempt()
            one_line(error)


class TestFullDisk:
    def test_free_space_is_checked_where_the_path_will_be(self, tmp_path: Path) -> None:
        path = tmp_path / "not" / "yet" / "there"
        require_free_space(path, 1, 1)
        with pytest.raises(BagError) as error:
            require_free_space(path, 10**15, 1)
        assert one_line(error).startswith(f"{path}: 960000000000.1 MB of disk space needed")

    @pytest.mark.parametrize("joints", [1, 2, 7])
    def test_noise_takes_less_room_than_is_asked_for(
        self, tmp_path: Path, joints: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        names = [f"a_long_name_of_joint_{k}" for k in range(joints)]
        messages = synthetic_recording(joint_names=names, ticks=500).messages
        path = write_bag(tmp_path / "bag", messages, METADATA)
        size = sum(file.stat().st_size for file in path.iterdir())
        monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=size))
        with pytest.raises(BagError, match="of disk space needed"):
            require_free_space(path, 500, joints)
        monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=40 * size))
        require_free_space(path, 500, joints)


class TestBlocks:
    TICKS = 733

    @pytest.fixture
    def recording(self) -> Topics:
        topics = synthetic_recording(ticks=self.TICKS).by_topic()
        return {topic: topics[topic] for topic in DATA_STREAMS}

    def blocks(self, topics: Topics, size: int) -> Iterator[tuple[list[int], Topics]]:
        times = [tick * PERIOD_NS for tick in range(self.TICKS)]
        for start in range(0, self.TICKS, size):
            part = slice(start, start + size)
            yield times[part], {topic: raws[part] for topic, raws in topics.items()}

    @pytest.mark.parametrize("size", [1, 50, 500])
    def test_messages_and_times_are_those_of_messages_written_one_by_one(
        self, tmp_path: Path, recording: Topics, size: int
    ) -> None:
        clock = (CLOCK, b"\0\1\0\0abcdefgh", 3 * PERIOD_NS)
        with BagWriter(tmp_path / "one", metadata=METADATA) as writer:
            writer.write(*clock)
            for tick in range(self.TICKS):
                for topic, raws in recording.items():
                    writer.write(topic, raws[tick], tick * PERIOD_NS)
        with BagWriter(tmp_path / "blocks", metadata=METADATA) as writer:
            writer.write(*clock)
            for times, part in self.blocks(recording, size):
                writer.write_block(times, part)

        one, blocks = (list(iterate_messages(tmp_path / name)) for name in ("one", "blocks"))
        assert blocks == one
        path = tmp_path / "blocks" / "blocks_0.mcap"
        with path.open("rb") as file:
            assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > 4 * self.TICKS
        # Opening compares the type hashes with the definitions.
        with AnyReader([tmp_path / "blocks"]) as reader:
            read = [(c.topic, c.msgtype, time, raw) for c, time, raw in reader.messages()]
        assert read == [(absolute(t), TOPICS[t].type, time, raw) for t, time, raw in one]

    @pytest.mark.parametrize("size", [7, 50])
    def test_what_is_not_yet_in_the_file_is_bounded(
        self, tmp_path: Path, recording: Topics, size: int
    ) -> None:
        writer = BagWriter(tmp_path / "bag", metadata={})
        most = 0
        for times, part in self.blocks(recording, size):
            writer.write_block(times, part)
            read = readable(tmp_path / "bag")
            last_ns = max((time for _, time, _ in read), default=-PERIOD_NS)
            most = max(most, times[-1] - last_ns)
        writer.close()
        assert most + size * PERIOD_NS <= FLUSH_INTERVAL_NS


# --- Bags that their recorder left unfinished are finished by whoever finds them; others stay ---

MESSAGES = synthetic_recording(ticks=160).messages
LOST = 7
"""Messages that a killed writer loses in the tests below."""


def unfinished(path: Path, messages: Sequence[Message] = MESSAGES) -> Path:
    """A bag as a killed writer leaves it, without its last messages."""
    writer = BagWriter(path, metadata=METADATA)
    write_all(writer, messages[:-LOST])
    writer.flush()
    write_all(writer, messages[-LOST:])
    writer._file.close()
    return path


def test_finished_bag_is_that_of_a_recorder_that_lived(tmp_path: Path) -> None:
    path = unfinished(tmp_path / "a" / "bag")
    expected = contents(write_bag(tmp_path / "b" / "bag", MESSAGES[:-LOST], METADATA))
    note = finish_bag(path)
    count = len(MESSAGES) - LOST
    assert note == f"{path}: its recorder did not finish it: finished now, with {count} messages"
    assert contents(path) == expected
    assert finish_bag(path) == ""
    assert contents(path) == expected


def test_bag_that_is_being_recorded_is_left_alone(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", metadata=METADATA) as writer:
        write_all(writer, MESSAGES)
        before = contents(tmp_path / "bag")
        assert finish_bag(tmp_path / "bag") == ""
        assert contents(tmp_path / "bag") == before
    assert list(iterate_messages(tmp_path / "bag")) == list(MESSAGES)


def of_another_recorder(storage: bytes) -> bytes:
    return storage.replace(b"armimp", b"others", 1)


def damaged(storage: bytes) -> bytes:
    middle = len(storage) // 2
    return storage[:middle] + bytes([storage[middle] ^ 0xFF]) + storage[middle + 1 :]


@pytest.mark.parametrize("spoil", [of_another_recorder, damaged])
def test_unfinished_file_of_another_recorder_or_damaged_is_left_alone(
    tmp_path: Path, spoil: Callable[[bytes], bytes]
) -> None:
    path = unfinished(tmp_path / "bag")
    file = path / "bag_0.mcap"
    file.write_bytes(spoil(file.read_bytes()))
    before = contents(path)
    assert finish_bag(path) == ""
    assert contents(path) == before


def test_bag_that_cannot_be_written_is_named_and_still_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = unfinished(tmp_path / "bag")
    before = contents(path)

    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    note = finish_bag(path)
    assert note.startswith(f"{path}: its recorder did not finish it, and it cannot be finished now")
    assert note.endswith("Read-only file system")
    assert contents(path) == before
    assert read_bag(path).trials


def test_all_bags_of_a_result_are_finished_and_nothing_else_is_left(tmp_path: Path) -> None:
    bags = [unfinished(tmp_path / "bags" / name) for name in ("trial_1_joint_1", "trial_2_joint_2")]
    notes = finish_bags(tmp_path)
    assert [note.split(":")[0] for note in notes] == [str(bag) for bag in bags]
    assert [path.name for path in tmp_path.iterdir()] == ["bags"]
    assert finish_bags(tmp_path) == []
    assert finish_bags(tmp_path / "missing") == []


def cut_at(whole: bytes, size: int, path: Path) -> int:
    """Number of messages in a cut bag, the same however it is read; -1 if it is not finished."""
    (path / "bag_0.mcap").write_bytes(whole[:size])
    before = readable(path)
    note = finish_bag(path)
    if not note:
        assert before == []
        return -1
    with AnyReader([path]) as reader:
        after = [data for _, _, data in reader.messages()]
    assert after == [raw for _, _, raw in before]
    (path / FILE_NAME).unlink()
    return len(after)


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("step", [997, pytest.param(13, marks=pytest.mark.slow)])
def test_file_cut_anywhere_is_finished_up_to_the_cut(
    tmp_path: Path, figures: Figures, step: int
) -> None:
    path = unfinished(tmp_path / "bag", MESSAGES[:300])
    whole = (path / "bag_0.mcap").read_bytes()
    counts = [cut_at(whole, size, path) for size in [*range(0, len(whole), step), len(whole)]]
    assert counts == sorted(counts)
    assert counts[0] == -1
    assert counts[-1] == 300 - LOST
    assert len(set(counts)) == 4  # no header; no message; one chunk; both
    if step == 13:
        figures.add("bag of a killed recorder cut, then finished", len(counts))


def test_what_is_known_only_after_recording_is_added_to_the_metadata(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", metadata=METADATA) as writer:
        write_all(writer, MESSAGES)
        writer.add_metadata({"ledger": json.dumps({"lost": 0})})
    expected = METADATA | {"ledger": '{"lost": 0}'}
    assert read_bag(tmp_path / "bag").metadata == expected
    # The storage file alone has it, too.
    assert read_bag(tmp_path / "bag" / "bag_0.mcap").metadata == expected
    assert topics.TRIAL in read_bag(tmp_path / "bag").topics
