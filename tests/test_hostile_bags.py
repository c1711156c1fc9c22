"""Files made to harm: one line or a result, in bounded memory and time; nothing else touched."""

from pathlib import Path

import pytest

from support.fault_figures import Figures
from support.hostile_bags import ATTACKS, Outcome, tried

MOST_MEMORY, MOST_TIME = 1.5e9, 30.0
NOTES = ("note: ", "armimp: note: ", "trial ")
NAMED = ("/dev/zero", "parameter '", "not valid: ")
"""What a line may name in the place of the file: a device, a parameter, a verdict."""


def faults_of(outcome: Outcome, directory: Path) -> list[str]:
    """What is wrong with an outcome, in words; time is that of the processor."""
    status, said = outcome.told.status, outcome.told.err
    complaints = [line for line in said.splitlines() if not line.startswith(NOTES)]
    # A file that could be read to its end has a verdict, with a line for each of its reasons.
    verdicts = [line for line in complaints if line.startswith("armimp: not valid: ")]
    found = {
        f"ended with {status}": status not in (0, 1, 2),
        "traceback": "Traceback" in said,
        "no reason": bool(status) and not complaints,
        "refused by more than one line": len(complaints) > 1 and verdicts != complaints,
        "too many reasons": len(complaints) > 5,
        "no line of ours": not all(line.startswith("armimp: ") for line in complaints),
        "a line beyond reading": any(len(line) > 1300 for line in complaints),
        "file not named": not all(
            any(name in line for name in (str(directory), *NAMED)) for line in complaints
        ),
        f"{outcome.seconds:.0f} s": outcome.seconds > MOST_TIME,
        f"{outcome.memory / 1e9:.2f} GB": outcome.memory > MOST_MEMORY,
        "another file was touched": not outcome.untouched,
    }
    return [reason for reason, wrong in found.items() if wrong]


@pytest.mark.parametrize("name", ATTACKS)
def test_a_hostile_file_gets_one_line_in_bounded_memory_and_touches_nothing(
    name: str, tmp_path: Path, figures: Figures
) -> None:
    outcome = tried(name, tmp_path)
    figures.add(
        "hostile file",
        processor_time=(outcome.seconds, "s"),
        memory=(outcome.memory / 1e6, "MB"),
    )
    assert faults_of(outcome, tmp_path) == [], outcome.told.err[-500:]
