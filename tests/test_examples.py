"""The numbered examples run, and what they print makes sense."""

import contextlib
import io
import os
import re
import runpy
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from armimp_bringup.replay import BagPlayer, replay_bags
from armimp_estimation.bags.reader import BagContent
from support import known
from support.graph import free_domain
from support.places import ROOT

pytestmark = pytest.mark.slow

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
BY_NUMBER = {path.name[:2]: path for path in EXAMPLES}


def printed(number: str, *arguments: str) -> str:
    """What an example prints, run in this process, which has compiled and imported most already."""
    path, out = str(BY_NUMBER[number]), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):
        patch.setattr(sys, "argv", [path, *arguments])
        runpy.run_path(path, run_name="__main__")
    return out.getvalue()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        ("01", ["M11 = ", "K22 = ", "valid\n"]),
        ("02", ["welch_siso", "welch_full", "lpm_full"]),
        ("03", ["direct", "lpm_full"]),
        ("04", ["none", "dahl", "viscous", "valid\n"]),
        ("08", ["truth", "welch_siso", "welch_shifted"]),
        ("09", ["share 0.0: lock ratios 0.", "share 0.8: lock ratios 0.", "; limit 0.02\n"]),
    ],
)
def test_an_example_that_needs_no_graph_prints_what_it_is_about(
    number: str, words: list[str]
) -> None:
    out = printed(number)
    assert re.search(r"\d\.\d", out)
    assert [one for one in words if one not in out] == []


@pytest.fixture(scope="module")
def ran(environment: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The experiment of example 05 and what it printed."""
    directory = tmp_path_factory.mktemp("examples") / "out"
    return directory, printed("05", str(directory))


def test_an_experiment_runs_through_the_graph(ran: tuple[Path, str]) -> None:
    for line in ("trial 2 of 2: joint 2\n", "joint 2: 10000 samples, 0 lost", "\nvalid\n"):
        assert line in ran[1]
    assert ran[1].endswith("bags: trial_1_joint_1 trial_2_joint_2\n")


def test_the_reader_of_a_bag_needs_nothing_of_this_project() -> None:
    """The tutorial runs it."""
    assert not re.search(r"^(import|from) armimp", BY_NUMBER["06"].read_text("utf-8"), re.M)


def test_a_node_hears_the_results(ran: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    domain, heard = free_domain(), list[str]()
    play = BagPlayer.play

    def play_and_wait(player: BagPlayer, bag: BagContent, should_stop: Callable[[], bool]) -> None:
        play(player, bag, should_stop)
        # On a busy machine a replay may be over before the listener has discovered its nodes.
        player._spinner.spin(lambda: bool(heard))

    monkeypatch.setattr(BagPlayer, "play", play_and_wait)
    command, pipe = [sys.executable, str(BY_NUMBER["07"])], subprocess.PIPE
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    with subprocess.Popen(
        command, env=environment, stdout=pipe, stderr=pipe, text=True
    ) as listener:
        hearing = threading.Thread(target=heard.extend, args=(known(listener.stdout),))
        try:
            assert "listens" in known(listener.stderr).readline()
            hearing.start()
            bags = sorted((ran[0] / "bags").iterdir())
            summary = replay_bags(bags, ("lpm_full",), None, domain_id=domain).summary
            assert summary.valid
            hearing.join()
        finally:
            listener.kill()
    out = "".join(heard)
    assert "impedance_estimator: column 1: trial 1" in out
    assert "impedance_estimator: impedance: valid" in out
    (stiffness,) = re.findall(r"K row by row: (.*) N", out)
    found = [float(one) for one in stiffness.split()]
    assert found == [value for row in summary.estimators["lpm_full"].K for value in row]


def test_an_estimator_of_ones_own_works_on_bags(ran: tuple[Path, str]) -> None:
    out = printed("08", *(str(path) for path in sorted((ran[0] / "bags").iterdir())))
    assert {"truth", "welch_siso", "welch_shifted"} <= {
        line.split()[0] for line in out.splitlines()
    }
