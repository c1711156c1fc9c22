"""Bags cut at any byte and bags with any byte changed: read, or refused with one clear line."""

import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from armimp_common.errors import BagError, DataError
from armimp_estimation.bags.reader import read_bag
from support.bag_files import records_of, typed, write_bag, write_foreign
from support.fault_figures import Figures
from support.synthetic_bags import synthetic_recording

TICKS = 160
RECORDING = synthetic_recording(ticks=TICKS)
MESSAGES = list(RECORDING.messages)


def storage_file(bag: Path) -> Path:
    (file,) = (entry for entry in bag.iterdir() if entry.name != "metadata.yaml")
    return file


def samples_or_refusal(bag: Path) -> int:
    """Samples of the record, which must be those that were written; 0 if the bag is refused.

    A refusal is one line with the name of the bag.
    """
    try:
        content = read_bag(bag)
        said, records = "".join(content.notes), records_of(content)
    except (BagError, DataError) as error:
        said, records = str(error), []
    assert "\n" not in said
    if not records:
        assert str(bag) in said
        return 0
    (record,), (expected,) = records, RECORDING.records
    np.testing.assert_array_equal(record.position, expected.position[:, : record.samples])
    np.testing.assert_array_equal(record.torque, expected.torque[:, : record.samples])
    return record.samples


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.NONE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    ],
)
def test_foreign_bag_cut_anywhere_is_read_or_refused(
    tmp_path: Path, storage: StoragePlugin, mode: CompressionMode
) -> None:
    bag = write_foreign(tmp_path / "bag", typed(MESSAGES), storage=storage, mode=mode)
    file = storage_file(bag)
    whole = file.read_bytes()
    step = max(len(whole) // 50, 1)
    for size in (*range(40), *range(40, len(whole), step), len(whole) - 1):
        file.write_bytes(whole[:size])
        samples_or_refusal(bag)
    file.write_bytes(whole)
    assert samples_or_refusal(bag) == TICKS


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of so few samples that every byte of it can be tried."""
    path = tmp_path_factory.mktemp("small") / "bag"
    messages = [m for m in MESSAGES if m[1] < MESSAGES[0][1] + 60_000_000]
    return write_bag(path, messages, {"joint_names": '["shoulder", "elbow"]'})


@pytest.mark.timeout(1200)
class TestEveryByte:
    @pytest.mark.parametrize("step", [131, pytest.param(1, marks=pytest.mark.slow)])
    def test_cut_at_every_byte_it_is_read_up_to_there(
        self, small: Path, tmp_path: Path, figures: Figures, step: int
    ) -> None:
        whole = storage_file(small).read_bytes()
        file = tmp_path / "bag.mcap"
        samples: list[int] = []
        for size in (*range(0, len(whole), step), len(whole)):
            file.write_bytes(whole[:size])
            samples.append(samples_or_refusal(file))
        assert samples == sorted(samples)
        steps = sorted(set(samples))
        assert steps == [0, 50, 60]
        if step == 1:
            figures.add(
                "bag cut at every byte",
                len(samples),
                loss_before_the_cut=(float(max(np.diff(steps))), "ms"),
            )

    @pytest.mark.slow
    def test_metadata_cut_at_every_byte_is_used_or_refused(
        self, small: Path, tmp_path: Path, figures: Figures
    ) -> None:
        bag = tmp_path / "bag"
        shutil.copytree(small, bag)
        whole = (bag / "metadata.yaml").read_bytes()
        cuts = (whole[:size] for size in range(len(whole)))
        refused = self.refusals(bag, bag / "metadata.yaml", cuts)
        figures.add("metadata.yaml cut at every byte", len(whole), refused=(refused, ""))

    @pytest.mark.slow
    def test_every_byte_with_one_bit_flipped_is_read_or_refused(
        self, small: Path, tmp_path: Path, figures: Figures
    ) -> None:
        whole = storage_file(small).read_bytes()
        flipped = (
            whole[:where] + bytes([whole[where] ^ 1 << where % 8]) + whole[where + 1 :]
            for where in range(len(whole))
        )
        refused = self.refusals(tmp_path / "bag.mcap", tmp_path / "bag.mcap", flipped)
        figures.add("one bit of a bag flipped, in every byte", len(whole), refused=(refused, ""))

    @pytest.mark.slow
    def test_tail_of_zeros_as_after_a_loss_of_power_is_read_or_refused(
        self, small: Path, tmp_path: Path
    ) -> None:
        whole = storage_file(small).read_bytes()
        tails = (whole[:size] + bytes(len(whole) - size) for size in range(0, len(whole), 7))
        assert self.refusals(tmp_path / "bag.mcap", tmp_path / "bag.mcap", tails)

    def refusals(self, bag: Path, file: Path, contents: Iterable[bytes]) -> int:
        """Count the contents for which the bag is refused; of the others whole chunks are read."""
        refused = 0
        for content in contents:
            file.write_bytes(content)
            samples = samples_or_refusal(bag)
            assert samples in (0, 50, 60)
            refused += samples == 0
        return refused
