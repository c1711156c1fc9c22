"""Figures drawn by another process: the same ones, and never anything left behind."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from armimp_common.errors import DataError
from armimp_estimation.figure_process import FigureProcess
from armimp_estimation.figures import write_figures
from armimp_estimation.report import load_result
from support.results import METADATA, make_result
from support.synthetic_bags import synthetic_recording

NAMES = [
    f"{name}.{form}" for name in ("coherence", "impedance", "traces") for form in ("pdf", "png")
]
PARENT = """
import time
from armimp_estimation.figure_process import FigureProcess

process = FigureProcess()
process.start()
print(process.number, flush=True)
time.sleep(1000)
"""


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_result(tmp_path_factory.mktemp("figures") / "good")


@pytest.fixture
def directory(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "result"))


@pytest.fixture
def process() -> Iterator[FigureProcess]:
    with FigureProcess() as one:
        one.start()
        yield one


def drawn(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.iterdir() if path.suffix in (".png", ".pdf"))


def ended(number: int) -> bool:
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.01)
    return False


@pytest.mark.slow
def test_figures_are_to_the_byte_those_that_are_drawn_here(
    process: FigureProcess, directory: Path, tmp_path: Path
) -> None:
    process.draw(directory)
    here = tmp_path / "here"
    here.mkdir()
    write_figures(here, load_result(directory))
    assert process.finished()
    assert drawn(directory) == drawn(here) == NAMES
    for name in NAMES:
        assert (directory / name).read_bytes() == (here / name).read_bytes(), name


@pytest.mark.slow
def test_bags_that_are_named_are_taken_without_having_been_started_before(tmp_path: Path) -> None:
    recording = synthetic_recording(ticks=3000)
    metadata = {**METADATA, "truth": "null"}
    made = make_result(tmp_path / "made", messages=recording.messages, metadata=metadata)
    (made / "bags" / "session").rename(tmp_path / "elsewhere")
    with FigureProcess() as process:
        process.draw(made, [tmp_path / "elsewhere"])
        assert process.finished()
    assert drawn(made) == ["traces.pdf", "traces.png"]


@pytest.mark.slow
def test_when_a_figure_cannot_be_written_expect_its_path_in_the_error_and_the_others_drawn(
    process: FigureProcess, directory: Path
) -> None:
    (directory / "coherence.png").mkdir()
    process.draw(directory)
    with pytest.raises(DataError, match=r"/coherence\.png: cannot be written: Is a directory"):
        process.finished()
    assert set(drawn(directory)) == set(NAMES)


@pytest.mark.slow
def test_when_there_is_no_result_expect_to_be_told_that_nothing_is_drawn(
    process: FigureProcess, tmp_path: Path
) -> None:
    process.draw(tmp_path)
    assert not process.finished()


def test_when_the_process_is_killed_expect_to_be_told_that_nothing_is_drawn(
    process: FigureProcess, directory: Path
) -> None:
    assert process.number is not None
    os.kill(process.number, signal.SIGKILL)
    assert ended(process.number)
    process.draw(directory)
    assert not process.finished()
    assert drawn(directory) == []


@pytest.mark.slow
def test_an_interrupt_from_the_terminal_does_not_reach_it(
    process: FigureProcess, directory: Path
) -> None:
    assert process.number is not None
    os.kill(process.number, signal.SIGINT)
    process.draw(directory)
    os.kill(process.number, signal.SIGINT)
    assert process.finished()


@pytest.mark.parametrize("seconds", [0.0, 2.0])
def test_leaving_ends_the_process_whatever_it_does(seconds: float, directory: Path) -> None:
    with FigureProcess() as process:
        process.start()
        number = process.number
        time.sleep(seconds)
        process.draw(directory)
    assert number is not None
    assert not Path(f"/proc/{number}").exists()


def test_when_the_parent_is_killed_expect_the_process_to_end() -> None:
    command = [sys.executable, "-c", PARENT]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        try:
            number = int(parent.stdout.readline())
            there = Path(f"/proc/{number}").exists()
        finally:
            parent.kill()
    assert there
    assert ended(number)
