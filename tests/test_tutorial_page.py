"""Every command of docs/tutorial.md runs, in its order, and prints what the page shows."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.places import ROOT

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCK = re.compile(
    r"^```sh\n(?P<commands>.*?)^```\n(?:\n```text\n(?P<shown>.*?)^```$)?", re.M | re.S
)
TOLERANCE = 0.01
"""Relative, beside half of the last digit: other processors and versions round differently."""

STEPS = [(one["commands"], (one["shown"] or "").splitlines()) for one in BLOCK.finditer(PAGE)]
"""Each block of commands, and what the page shows of their output."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that looks like a clone after `make setup`, to the commands of the page."""
    clone = tmp_path_factory.mktemp("clone")
    (clone / "examples").symlink_to(ROOT / "examples")
    commands = clone / ".venv" / "bin"
    commands.mkdir(parents=True)
    for name, module in (("armimp", " -m armimp_bringup"), ("python", "")):
        (commands / name).write_text(f'#!/bin/sh\nexec "{sys.executable}"{module} "$@"\n')
        (commands / name).chmod(0o755)
    return clone


def words(line: str) -> list[str]:
    # How fast a trial ran is the business of the machine; it is the last number before the bag.
    return re.sub(r"\S+( +bags/)", r"*\1", line).split()


def alike(shown: str, real: str) -> bool:
    """Whether two lines are equal but for the last digits of numbers."""
    pairs = list(zip(words(shown), words(real), strict=False))
    return len(words(shown)) == len(words(real)) and all(_same(a, b) for a, b in pairs)


def _same(shown: str, real: str) -> bool:
    number = re.fullmatch(r"[-+]?\d+(?:\.(\d*))?", shown.strip("%,"))
    try:
        a, b = float(shown.strip("%,")), float(real.strip("%,"))
    except ValueError:
        return shown == real
    half = 0.5 * 0.1 ** len(number[1] or "") if number else 0.0
    return abs(a - b) <= TOLERANCE * abs(a) + half


def missing(shown: list[str], real: list[str]) -> Iterator[str]:
    """Lines of the page that the output does not have in this order; `…` stands for any."""
    rest = iter(real)
    for line in shown:
        if line.strip() in ("", "…"):
            continue
        if not any(alike(line, one) for one in rest):
            yield line


def test_every_command_runs_and_prints_what_the_page_shows(folder: Path) -> None:
    for commands, shown in STEPS[1:]:
        done = subprocess.run(
            ["bash", "-e", "-c", commands],
            cwd=folder,
            env={**os.environ, "COLUMNS": "120"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{commands}\n{done.stdout}"
        lost = list(missing(shown, done.stdout.splitlines()))
        assert not lost, f"{commands}\n{done.stdout}\nnot printed: {lost}"
    assert (folder / "results" / "first" / "report.html").exists()
