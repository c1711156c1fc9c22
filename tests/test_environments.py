"""Whatever environment a user has, a command ends with its verdict or one line, not a traceback."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from support.runs import FinishedRun

PATIENCE = 120.0
RUN = ["run", "--duration", "2"]
ESTIMATE = ["estimate"]
COMMAND = [sys.executable, "-c", "from armimp_bringup.__main__ import program; program()"]


def armimp(
    arguments: list[str],
    variables: Mapping[str, str | None] | None = None,
    *,
    shell: str = '"$@"',
    cwd: Path | None = None,
) -> subprocess.CompletedProcess[bytes]:
    changed = {**os.environ, **(variables or {})}
    done = subprocess.run(
        ["bash", "-c", shell, "bash", *COMMAND, *arguments],
        env={name: value for name, value in changed.items() if value is not None},
        capture_output=True,
        stdin=subprocess.DEVNULL,
        cwd=cwd,
        timeout=PATIENCE,
        check=False,
    )
    assert b"Traceback" not in done.stderr, done.stderr.decode(errors="replace")
    return done


@pytest.fixture(scope="module")
def bags(composed: FinishedRun) -> list[str]:
    return [str(path) for path in composed.bags]


@pytest.mark.slow
@pytest.mark.parametrize(
    "variables",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"PYTHONIOENCODING": "latin-1"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"LC_ALL": "xx_YY.none", "TERM": "dumb", "TMPDIR": "/does/not/exist"},
    ],
    ids=["ascii", "latin-1", "C", "unknown"],
)
def test_letters_that_the_terminal_does_not_have_cost_no_result(
    bags: list[str], variables: dict[str, str]
) -> None:
    table = armimp([*ESTIMATE, *bags], variables)
    assert table.returncode == 0
    assert table.stdout.split()[-1] == b"valid"
    assert armimp([*ESTIMATE, "--json", *bags], variables).stdout.isascii()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shell", "status", "said"),
    [
        ('"$@" >&-', 0, b""),
        ('"$@" <&- >&- 2>&-', 0, b""),
        ('"$@" >/dev/full', 1, b"armimp: No space left on device"),
        ('"$@" | head -0; exit ${PIPESTATUS[0]}', 1, b""),
    ],
    ids=["closed", "all closed", "full", "reader gone"],
)
def test_an_output_that_takes_nothing_is_no_traceback(
    bags: list[str], tmp_path: Path, shell: str, status: int, said: bytes
) -> None:
    done = armimp([*ESTIMATE, *bags, "--out", str(tmp_path / "out")], shell=shell)
    assert done.returncode == status
    assert done.stderr.strip() == said
    assert (tmp_path / "out" / "summary.json").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("home", [None, "/proc/nothing"])
def test_no_home_is_needed(tmp_path: Path, home: str | None) -> None:
    processes = "composed" if home is None else "separate"
    out = tmp_path / "out"
    done = armimp([*RUN, "--processes", processes, "--out", str(out)], {"HOME": home})
    assert done.returncode == 0, done.stderr
    assert all(line.startswith(b"trial ") for line in done.stderr.splitlines()), done.stderr


@pytest.mark.slow
def test_a_directory_that_cannot_be_written_is_one_line() -> None:
    done = armimp(RUN, cwd=Path("/proc"))
    (line,) = done.stderr.splitlines()
    assert (done.returncode, b"cannot be made" in line) == (2, True)


def test_too_few_open_files_are_one_line(tmp_path: Path) -> None:
    done = armimp([*RUN, "--out", str(tmp_path / "out")], shell='ulimit -n 16; "$@"')
    assert done.returncode == 1
    expected = b"armimp: 16 open files are permitted (ulimit -n), and 64 are needed"
    assert done.stderr.splitlines() == [expected]
    assert not (tmp_path / "out").exists()
