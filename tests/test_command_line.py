"""The command ``armimp`` as a user meets it: in a terminal, results, errors, exit status."""

import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyte
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_common.topics import TRIAL
from armimp_estimation.bags.reader import read_bag
from support.bag_files import iterate_messages, write_bag
from support.command import call, interrupted, program
from support.processes import processes_of, wait_until

ROWS = 24
PROGRAM = """
import sys, pytest
from armimp_bringup.cli import main
from armimp_bringup.terminal import Display
from support.telling import tell_by_samples

def drawn(display, snapshot, show=Display.show):
    show(display, snapshot)
    display._refresh()

with pytest.MonkeyPatch.context() as patch:
    tell_by_samples(patch)
    patch.setattr(Display, "show", drawn)
    sys.exit(main(sys.argv[1:]))
"""
"""The command, which draws every progress message rather than one a second."""
SHORT = ["run", "--duration", "2", "--seed", "5"]


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A finished short experiment, and the screen after each piece of output."""

    directory: Path
    screens: list[list[str]]


def screens(command: list[str], columns: int) -> list[list[str]]:
    """Run a command in a terminal, and return its screen after each piece of output."""
    screen = pyte.Screen(columns, ROWS)
    stream = pyte.ByteStream(screen)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, columns, 0, 0))
    shared = str(Path(__file__).parent)
    environment = {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": shared}
    for name in ("COLUMNS", "LINES", "NO_COLOR"):
        environment.pop(name, None)
    seen: list[list[str]] = []
    with subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    ) as process:
        os.close(theirs)
        while True:
            try:
                piece = os.read(ours, 1 << 16)
            except OSError:  # with which Linux reports that the other end is closed
                break
            # A piece may hold several drawings, each of which begins at the first column.
            for part in re.split(rb"(?=\r)", piece):
                stream.feed(part)
                seen.append([line.rstrip() for line in screen.display])
        assert process.wait() == 0
    os.close(ours)
    return seen


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    directory = tmp_path_factory.mktemp("experiment") / "A"
    command = [sys.executable, "-c", PROGRAM, *SHORT, "--out", str(directory)]
    return Seen(directory=directory, screens=screens(command, 80))


def bags(directory: Path) -> list[str]:
    return sorted(str(path) for path in (directory / "bags").iterdir())


def estimated_and_replayed(*bags: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """What both commands print of bags; their verdicts must agree."""
    estimated, replayed = (call(command, *bags, "--json") for command in ("estimate", "replay"))
    assert estimated.status == replayed.status
    return json.loads(estimated.out), json.loads(replayed.out)


def test_a_run_leaves_bags_summary_curves_figure_and_parameters(seen: Seen) -> None:
    kinds = [".pdf", ".png"]
    figures = {name + kind for name in ("coherence", "impedance", "traces") for kind in kinds}
    numbers = {"frf.npz", "parameters.yaml", "report.html", "summary.json"}
    assert {path.name for path in seen.directory.iterdir()} == {"bags"} | numbers | figures
    summary = json.loads((seen.directory / "summary.json").read_text())
    assert summary["valid"] is True
    assert [trial["bag"] for trial in summary["trials"]] == [
        "bags/trial_1_joint_1",
        "bags/trial_2_joint_2",
    ]
    assert [trial["ticks"] for trial in summary["trials"]] == [2000, 2000]
    assert [trial["lost"] for trial in summary["trials"]] == [0, 0]
    assert summary["config"]["experiment"]["seed"] == 5
    assert summary["config"]["versions"]["numpy"] == np.__version__


def test_estimate_and_replay_give_the_numbers_of_the_live_run_to_the_last_digit(
    seen: Seen,
) -> None:
    live = json.loads((seen.directory / "summary.json").read_text())

    estimated, replayed = estimated_and_replayed(*bags(seen.directory))

    assert estimated["estimators"] == live["estimators"]
    assert replayed["estimators"] == live["estimators"]
    assert estimated["truth"] == replayed["truth"] == live["truth"]
    assert estimated["seed"] == replayed["seed"] == 5
    assert estimated["valid"] is True


def test_a_recording_without_trial_statuses_is_replayed_too(seen: Seen, tmp_path: Path) -> None:
    copies = []
    for bag in bags(seen.directory):
        untold = (one for one in iterate_messages(Path(bag)) if one[0] != TRIAL)
        copies.append(str(write_bag(tmp_path / Path(bag).name, untold, {})))

    estimated, replayed = estimated_and_replayed(*copies)

    assert estimated["valid"] is True
    assert replayed["estimators"] == estimated["estimators"]
    assert estimated["truth"] is estimated["seed"] is replayed["seed"] is None
    assert estimated["estimators"]["welch_siso"]["vaf"] is None


def test_recordings_that_were_cut_are_estimated_and_replayed_to_one_verdict(
    seen: Seen, tmp_path: Path
) -> None:
    copies = []
    for bag in bags(seen.directory):
        messages = list(iterate_messages(Path(bag)))
        left = messages[: -len(messages) // 8]
        copies.append(str(write_bag(tmp_path / Path(bag).name, left, {})))

    estimated, replayed = estimated_and_replayed(*copies)

    assert replayed["estimators"] == estimated["estimators"] != {}
    assert replayed["problems"] == estimated["problems"]
    short = [one for one in estimated["problems"] if one["code"] == "cut_short"]
    assert [(one["trial"], one["severity"]) for one in short] == [(1, "note"), (2, "note")]


def test_help_of_run_states_the_defaults_of_the_configuration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    told = call("run", "-h")
    assert told.status == 0
    text = " ".join(told.out.split())
    for name in ("friction", "resolution", "perturbation", "duration", "seed", "mode", "joints"):
        default = ExperimentConfig.model_fields[name].default
        shown = f"{default:g}" if isinstance(default, float) else str(default)
        assert re.search(rf"--{name} [^\[]*\[default: \({shown}\)\]", text), name


@pytest.mark.parametrize(
    ("processes", "bag"),
    [
        ("composed", "trial_1_joint_1"),
        pytest.param("composed", "trial_2_joint_2", marks=pytest.mark.slow),
        pytest.param("separate", "trial_1_joint_1", marks=pytest.mark.slow),
    ],
)
def test_when_interrupted_expect_closed_bags_exit_status_1_and_no_process_left(
    processes: str, bag: str, tmp_path: Path
) -> None:
    last = tmp_path / "bags" / bag
    with program("run", "--out", str(tmp_path), "--processes", processes) as process:
        wait_until(
            lambda: any(file.stat().st_size >= 300_000 for file in last.glob("*.mcap")), "a bag"
        )
        assert "interrupted by the user" in "".join(interrupted(process, 1))
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["valid"] is False
    assert summary["problems"][0]["code"] == "interrupted"
    assert bags(tmp_path)[-1] == str(last)
    for one in bags(tmp_path):
        assert (Path(one) / "metadata.yaml").exists()
        (trial,) = read_bag(Path(one)).trials
        assert trial.record is not None
        assert (trial.record.samples < 50_000) == (one == str(last))
    assert not processes_of(tmp_path)


def test_the_last_screen_has_the_trials_the_verdict_and_the_place_and_no_progress(
    seen: Seen,
) -> None:
    last = [line for line in seen.screens[-1] if line]
    assert [line for line in last if "bags/trial_2_joint_2" in line]
    assert "valid" in last
    text = "".join(last)  # a long path goes over several lines
    assert f"results in {seen.directory}" in text
    assert "left" not in text
    assert "drawing" not in text

    bars = {line for screen in seen.screens for line in screen if "left" in line}
    assert bars
    for line in bars:
        assert line.startswith("trial ")
        assert "━" in line
        assert line.endswith(" left")
    phases = {
        line.split(",")[0] for screen in seen.screens for line in screen if line.endswith(" s")
    }
    assert {"starting", "estimating", "drawing figures and report"} <= phases


def test_a_result_that_is_there_outlives_an_interruption_while_it_is_drawn(
    seen: Seen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("armimp_bringup.presentation._draw", interrupt)
    assert call("estimate", str(seen.directory), "--out", str(tmp_path / "out")).status == 0
    assert (tmp_path / "out" / "summary.json").exists()


_LOADING = """
from os import getpid, kill; from time import sleep; from weakref import finalize
from armimp_bringup import __main__, cli
def load(*_):
    try:
        {}
    except KeyboardInterrupt:
        raise SystemError from None
cli.load_config = load
__main__.program()
"""


@pytest.mark.parametrize(
    "interrupt", ["kill(getpid(), 2)", "finalize(set(), kill, getpid(), 2); sleep(9)"]
)
def test_when_a_module_makes_something_else_of_an_interrupt_expect_one_line(interrupt: str) -> None:
    command = [sys.executable, "-c", _LOADING.format(interrupt), "run"]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (told.returncode, told.stderr, told.stdout) == (130, "armimp: interrupted\n", "")
