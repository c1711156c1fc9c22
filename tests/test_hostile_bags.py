"""Files made to harm: one line or a result, in bounded memory and time; nothing else touched."""

from __future__ import annotations

import importlib.util
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Final

import pytest

from armimp_common.fault_figures import Figures

_MOST_MEMORY: Final = 1.5e9
_MOST_TIME: Final = 30.0
_KILLED_AFTER: Final = 60.0
_ADDRESS_SPACE: Final = 8 << 30  # so that what fails does not take the machine with it

ARMIMP: Final = Path(sys.executable).with_name("armimp")


def _hostile() -> ModuleType:
    path = Path(__file__).resolve().parent / "hostile_bags.py"
    spec = importlib.util.spec_from_file_location("hostile_bags", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


HOSTILE: Final = _hostile()


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command made of a file.

    Attributes
    ----------
    status : int
        Exit status; negative for a signal.
    err : str
        Standard error.
    seconds : float
        CPU time of the process.
    memory : float
        Most resident memory, bytes.
    """

    status: int
    err: str
    seconds: float
    memory: float


def attacked(name: str, directory: Path) -> Outcome:
    """Run the command on the file of an attack, and measure."""
    inside = directory / "inside"
    inside.mkdir()
    witness = directory / HOSTILE.WITNESS
    witness.mkdir()
    (witness / "canary").write_bytes(b"ten years of work")
    arguments = HOSTILE.ATTACKS[name](inside)
    with (directory / "err").open("w+b") as err:
        process = subprocess.Popen(
            [ARMIMP, *arguments],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=err,
            cwd=directory, start_new_session=True,
        )  # fmt: skip
        resource.prlimit(process.pid, resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
        end = time.monotonic() + _KILLED_AFTER
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            if time.monotonic() > end:
                os.killpg(process.pid, signal.SIGKILL)
            time.sleep(0.02)
        process.returncode = os.waitstatus_to_exitcode(status)
        err.seek(0)
        said = err.read().decode(errors="replace")
    return Outcome(
        status=process.returncode,
        err=said,
        seconds=usage.ru_utime + usage.ru_stime,
        memory=usage.ru_maxrss * 1024.0,
    )


def faults_of(outcome: Outcome, directory: Path) -> list[str]:
    """What is wrong with an outcome, in words."""
    found = []
    complaints = [
        line for line in outcome.err.splitlines() if not line.startswith(("note: ", "trial "))
    ]
    if outcome.status not in (0, 1, 2):
        found.append(f"ended with {outcome.status}")
    if "Traceback" in outcome.err:
        found.append("traceback")
    if outcome.status and not complaints:
        found.append("no reason given")
    if any(not line.startswith("armimp: ") or len(line) > 1500 for line in complaints):
        found.append("more than one clear line")
    if outcome.status and len(complaints) == 1:
        first = complaints[0]
        if not any(part in first for part in (str(directory), "/dev/zero")):
            found.append("file not named")
    if outcome.seconds > _MOST_TIME:
        found.append(f"{outcome.seconds:.0f} s")
    if outcome.memory > _MOST_MEMORY:
        found.append(f"{outcome.memory / 1e9:.2f} GB")
    canary = directory / HOSTILE.WITNESS / "canary"
    if not canary.is_file() or canary.read_bytes() != b"ten years of work":
        found.append("another file was touched")
    return found


def withstands(name: str, directory: Path, figures: Figures) -> None:
    outcome = attacked(name, directory)
    figures.add(
        "hostile file",
        time_of_the_processor=(outcome.seconds, "s"),
        memory=(outcome.memory / 1e6, "MB"),
    )
    problems = faults_of(outcome, directory)
    assert not problems, (problems, outcome.err[-3000:])


@pytest.mark.parametrize("name", HOSTILE.QUICK)
def test_a_hostile_file_gets_one_line_in_bounded_memory_and_touches_nothing(
    name: str, tmp_path: Path, figures: Figures
) -> None:
    withstands(name, tmp_path, figures)


@pytest.mark.faults
@pytest.mark.parametrize("name", sorted(set(HOSTILE.ATTACKS) - set(HOSTILE.QUICK)))
def test_every_hostile_file_gets_one_line_in_bounded_memory_and_touches_nothing(
    name: str, tmp_path: Path, figures: Figures
) -> None:
    withstands(name, tmp_path, figures)
