"""Files made to harm: one line or a result, in bounded memory and time; nothing else touched."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import pytest

from support.fault_figures import Figures
from support.hostile_bags import ATTACKS, QUICK

_MOST_MEMORY: Final = 1.5e9
_MOST_TIME: Final = 30.0
_NOTES = ("note: ", "armimp: note: ", "trial ")
_VERDICT: Final = "armimp: not valid: "
_MOST_REASONS: Final = 5
_LONGEST_LINE: Final = 1300
NAMED: Final = ("/dev/zero", "parameter '", "not valid: ")
"""What a line may name in the place of the file: a device, a parameter, a verdict."""


def outcomes(names: Sequence[str], directory: Path) -> Iterator[dict[str, Any]]:
    """What the command made of the files of these attacks, all from one process."""
    command = [sys.executable, "-m", "support.hostile_bags", str(directory), *names]
    here = Path(__file__).resolve().parent
    with subprocess.Popen(command, cwd=here, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield from map(json.loads, process.stdout)
    assert process.returncode == 0


def faults_of(outcome: dict[str, Any], directory: Path) -> list[str]:
    """What is wrong with an outcome, in words; time is that of the processor."""
    said = outcome["err"]
    complaints = [line for line in said.splitlines() if not line.startswith(_NOTES)]
    # A file that could be read to its end has a verdict, with a line for each of its reasons.
    refusals = [line for line in complaints if not line.startswith(_VERDICT)]
    found = [
        (outcome["status"] not in (0, 1, 2), f"ended with {outcome['status']}"),
        ("Traceback" in said, "traceback"),
        (bool(outcome["status"]) and not complaints, "no reason"),
        (
            len(refusals) > 1 or (bool(refusals) and refusals != complaints),
            f"{refusals} refused it",
        ),
        (len(complaints) > _MOST_REASONS, f"{len(complaints)} reasons"),
        (any(not line.startswith("armimp: ") for line in complaints), "no line of ours"),
        (any(len(line) > _LONGEST_LINE for line in complaints), "a line beyond reading"),
        (
            not all(any(name in line for name in (str(directory), *NAMED)) for line in complaints),
            "file not named",
        ),
        (outcome["seconds"] > _MOST_TIME, f"{outcome['seconds']:.0f} s"),
        (outcome["memory"] > _MOST_MEMORY, f"{outcome['memory'] / 1e9:.2f} GB"),
        (not outcome["untouched"], "another file was touched"),
    ]
    return [reason for wrong, reason in found if wrong]


def withstood(names: Sequence[str], directory: Path, figures: Figures) -> None:
    wrong = {}
    tried = 0
    for outcome in outcomes(names, directory):
        tried += 1
        figures.add(
            "hostile file",
            processor_time=(outcome["seconds"], "s"),
            memory=(outcome["memory"] / 1e6, "MB"),
        )
        if problems := faults_of(outcome, directory):
            wrong[outcome["name"]] = (problems, outcome["err"][-500:])
    assert tried == len(names)
    assert wrong == {}


def test_a_hostile_file_gets_one_line_in_bounded_memory_and_touches_nothing(
    tmp_path: Path, figures: Figures
) -> None:
    withstood(QUICK, tmp_path, figures)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_every_hostile_file_gets_one_line_in_bounded_memory_and_touches_nothing(
    tmp_path: Path, figures: Figures
) -> None:
    withstood(sorted(set(ATTACKS) - set(QUICK)), tmp_path, figures)
