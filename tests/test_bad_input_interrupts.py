"""Ctrl-C at any moment: one line, exit status 130 without a result, never a traceback."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import pytest

from support.bag_files import write_bag
from support.command import call
from support.synthetic_bags import recorded_arm

pytestmark = [pytest.mark.alone, pytest.mark.slow]

PATIENCE = 60.0


@contextmanager
def program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "armimp_bringup.cli", *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def interrupt(process: subprocess.Popen[str], *, status: int = 130) -> list[str]:
    """Lines of standard error after SIGINT."""
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == status, error
    return error.splitlines()


def test_while_it_measures_expect_one_line() -> None:
    with program("bench") as process:
        assert process.stderr is not None
        assert process.stderr.readline()
        told = interrupt(process)
    assert told[-1] == "armimp: interrupted"
    assert len([line for line in told if line.startswith("armimp: ")]) == 1
    assert not any("Traceback" in line for line in told)


def test_a_replay_leaves_an_invalid_result(tmp_path: Path) -> None:
    bag, out = tmp_path / "bag", tmp_path / "out"
    write_bag(bag, recorded_arm(20_000).messages, {})
    with program("replay", str(bag), "--out", str(out)) as process:
        assert process.stderr is not None
        while not process.stderr.readline().startswith("trial 1/2"):
            assert process.poll() is None
        told = interrupt(process, status=1)
    assert "armimp: not valid: interrupted by the user" in told
    assert not any("Traceback" in line for line in told)
    assert (out / "summary.json").exists()


def test_when_an_import_is_interrupted_expect_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def compiled_module(*_: object) -> NoReturn:
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr("armimp_bringup.cli.load_config", compiled_module)
    told = call("run")
    assert (told.status, told.err, told.out) == (130, "armimp: interrupted\n", "")
