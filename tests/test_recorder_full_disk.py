"""A disk that is full is found before a trial; one that fills up ends the trial in good order."""

import errno
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from armimp_common.errors import ArmimpError, BagError
from armimp_common.status import Progress
from armimp_estimation.bags.reader import BAGS
from armimp_estimation.bags.writer import BagWriter, finish_bag
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.recorder import TrialRecorder
from support.bag_files import assert_other_readers_open, iterate_messages, readable, write_all
from support.streams import record
from support.synthetic_bags import synthetic_recording
from support.telling import tell_by_samples

MESSAGES = synthetic_recording(perturbed=(0, 1), ticks=2000, settle=10, rest=10).messages
BAG_1 = "trial_1_joint_1"


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Make a file system of so many MB, where this process may."""
    mounted: list[Path] = []

    def make(megabytes: int) -> Path:
        place = tmp_path / f"disk_{megabytes}"
        place.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(place)]
        if os.geteuid() != 0 or shutil.which("mount") is None:
            pytest.skip("only root can make a file system")
        if subprocess.run(command, check=False, capture_output=True).returncode != 0:
            pytest.skip("file systems cannot be mounted here")
        mounted.append(place)
        return place

    yield make
    for place in mounted:
        subprocess.run(["umount", "-l", str(place)], check=True)


def fill(place: Path) -> None:
    """Leave no room on a file system."""
    with (place / "filler").open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(1 << 12))


def assert_finished(bag: Path) -> int:
    """The bag is whole and opens everywhere; its number of messages."""
    assert {path.name for path in bag.iterdir()} == {f"{bag.name}_0.mcap", "metadata.yaml"}
    return assert_other_readers_open(bag)


def test_when_the_disk_is_nearly_full_expect_a_refusal_before_the_trial(
    small_disk: Callable[[int], Path],
) -> None:
    disk = small_disk(2)
    recording = TrialRecorder(EstimatorParameters(directory=str(disk)), lambda *_: None)
    with pytest.raises(BagError, match=r"trial_1_joint_1: .* MB of disk space needed, \d"):
        record(recording, MESSAGES[:1])
    assert list(disk.iterdir()) == []


class LimitedFile:
    """A file on a disk with little room, on which writes succeed in part, then not at all."""

    def __init__(self, file: Any, room: int) -> None:
        self._file = file
        self.room = room

    def write(self, data: memoryview) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count: int = self._file.write(data[: self.room])
        self.room -= count
        return count

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@pytest.mark.parametrize("room", [0, 1, 3000, 5000])
@pytest.mark.parametrize("room_at_the_end", [0, 500, 10**6])
def test_wherever_writing_stops_the_file_holds_whole_records_only(
    tmp_path: Path, room: int, room_at_the_end: int
) -> None:
    writer = BagWriter(tmp_path / "bag", metadata={})
    write_all(writer, MESSAGES[:10])
    limited = LimitedFile(writer._file, room)
    writer._file = limited  # type: ignore[assignment]
    written = 10

    def write_the_rest() -> None:
        nonlocal written
        for topic, time, raw in MESSAGES[10:]:
            writer.write(topic, raw, time)
            written += 1

    with pytest.raises(BagError, match="bag: cannot be written: disk full"):
        write_the_rest()
    limited.room = room_at_the_end
    with suppress(BagError):
        writer.close()

    bag = tmp_path / "bag"
    if room_at_the_end == 10**6:
        # Even messages that were waiting when the disk was full have been written.
        assert assert_finished(bag) == written + 1
        return
    if read := readable(bag):  # or not one chunk found room
        finish_bag(bag)
        assert assert_finished(bag) == len(read)
    assert read == list(MESSAGES[: len(read)])
    assert len(read) > written - 256


def test_when_the_disk_fills_up_in_a_trial_expect_the_run_to_end_and_to_say_so(
    small_disk: Callable[[int], Path], environment: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = small_disk(80)
    tell_by_samples(monkeypatch)
    seen: list[int] = []

    def on_progress(progress: Progress) -> None:
        if not seen and progress.samples > 2000:
            seen.append(progress.samples)
            fill(disk)

    config = ExperimentConfig.model_validate({"duration": 20.0})
    bag = disk / "out" / BAGS / BAG_1
    with pytest.raises(ArmimpError) as error:
        run_experiment(config, disk / "out", on_progress=on_progress)

    assert seen
    # The node has said it of the bag; the run ends with one line.
    assert "summary.json: cannot be written: disk full" in str(error.value)
    assert "\n" not in str(error.value)
    # The controller has stopped at once: no other trial has begun.
    assert [one.name for one in (disk / "out" / BAGS).iterdir()] == [BAG_1]
    assert len(list(iterate_messages(bag))) > 4 * seen[0]
