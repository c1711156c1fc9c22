"""Bags that their recorder left unfinished are finished by whoever finds them; others stay."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from armimp_common import topics
from armimp_common.errors import BagError
from armimp_estimation.bags import BagWriter, read_bag
from armimp_estimation.bags.metadata_yaml import FILE_NAME
from armimp_estimation.bags.writer import finish_bag, finish_bags
from support.bag_files import iterate_messages, write_bag
from support.fault_figures import Figures
from support.synthetic_bags import Message, synthetic_recording

MESSAGES = synthetic_recording(ticks=160).messages
METADATA = {"seed": "1", "joint_names": '["shoulder", "elbow"]', "note": "12:30\nü"}
LOST = 7
"""Messages that a killed writer takes with it below."""


def unfinished(path: Path, messages: Sequence[Message] = MESSAGES) -> Path:
    """A bag as a killed writer leaves it, without its last messages."""
    writer = BagWriter(path, metadata=METADATA)
    for topic, log_time_ns, raw in messages[: len(messages) - LOST]:
        writer.write(topic, raw, log_time_ns)
    writer.flush()
    for topic, log_time_ns, raw in messages[len(messages) - LOST :]:
        writer.write(topic, raw, log_time_ns)
    writer._file.close()
    return path


def finished(path: Path) -> Path:
    """The bag of a writer that got the same messages and lived."""
    return write_bag(path, MESSAGES[: len(MESSAGES) - LOST], METADATA)


def content_of(path: Path) -> dict[str, bytes]:
    return {entry.name: entry.read_bytes() for entry in path.iterdir()}


def test_finished_bag_is_that_of_a_recorder_that_lived(tmp_path: Path) -> None:
    path = unfinished(tmp_path / "a" / "bag")
    note = finish_bag(path)
    count = len(MESSAGES) - LOST
    assert note == f"{path}: its recorder did not finish it: finished now, with {count} messages"
    assert content_of(path) == content_of(finished(tmp_path / "b" / "bag"))
    assert finish_bag(path) == ""
    assert content_of(path) == content_of(finished(tmp_path / "c" / "bag"))


def test_bag_that_is_being_recorded_is_left_alone(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", metadata=METADATA)
    for topic, log_time_ns, raw in MESSAGES:
        writer.write(topic, raw, log_time_ns)
    before = content_of(tmp_path / "bag")
    assert finish_bag(tmp_path / "bag") == ""
    assert content_of(tmp_path / "bag") == before
    writer.close()
    assert list(iterate_messages(tmp_path / "bag")) == list(MESSAGES)


def test_unfinished_file_of_another_recorder_is_left_alone(tmp_path: Path) -> None:
    path = unfinished(tmp_path / "bag")
    file = path / "bag_0.mcap"
    file.write_bytes(file.read_bytes().replace(b"armimp", b"others", 1))
    before = content_of(path)
    assert finish_bag(path) == ""
    assert content_of(path) == before


def test_bag_that_cannot_be_written_is_named_and_still_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = unfinished(tmp_path / "bag")
    before = content_of(path)

    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    note = finish_bag(path)
    assert note.startswith(f"{path}: its recorder did not finish it, and it cannot be finished now")
    assert note.endswith("Read-only file system")
    assert content_of(path) == before
    assert read_bag(path).trials


def test_all_bags_of_a_result_are_finished_and_nothing_else_is_left(tmp_path: Path) -> None:
    bags = [unfinished(tmp_path / "bags" / name) for name in ("trial_1_joint_1", "trial_2_joint_2")]
    notes = finish_bags(tmp_path)
    assert [note.split(":")[0] for note in notes] == [str(bag) for bag in bags]
    assert [path.name for path in tmp_path.iterdir()] == ["bags"]
    assert finish_bags(tmp_path) == []
    assert finish_bags(tmp_path / "missing") == []


def cut_at(whole: bytes, size: int, path: Path) -> int:
    """Messages in a bag whose file was cut, which must be the same however it is read; or -1."""
    (path / "bag_0.mcap").write_bytes(whole[:size])
    try:
        before = list(iterate_messages(path))
    except BagError:
        before = []
    metadata = (path / FILE_NAME).read_bytes()
    note = finish_bag(path)
    if not note:
        assert before == []
        return -1
    with AnyReader([path]) as reader:
        after = [data for _, _, data in reader.messages()]
    assert after == [raw for _, _, raw in before]
    (path / FILE_NAME).write_bytes(metadata)
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


def test_damaged_bag_is_left_for_the_reader_to_refuse(tmp_path: Path) -> None:
    path = unfinished(tmp_path / "bag")
    file = path / "bag_0.mcap"
    whole = bytearray(file.read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    file.write_bytes(whole)
    before = content_of(path)
    assert finish_bag(path) == ""
    assert content_of(path) == before
    with pytest.raises(BagError, match="damaged record"):
        read_bag(path)


def test_what_is_known_only_after_recording_is_added_to_the_metadata(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", metadata=METADATA) as writer:
        for topic, log_time_ns, raw in MESSAGES:
            writer.write(topic, raw, log_time_ns)
        writer.add_metadata({"ledger": json.dumps({"lost": 0})})
    expected = METADATA | {"ledger": '{"lost": 0}'}
    assert read_bag(tmp_path / "bag").metadata == expected
    # The storage file alone has it, too.
    assert read_bag(tmp_path / "bag" / "bag_0.mcap").metadata == expected
    assert topics.TRIAL in read_bag(tmp_path / "bag").topics
