"""Experiments keep to themselves: no other one and no other machine can hear or reach them."""

import json
import os
import subprocess
from contextlib import AbstractContextManager, ExitStack
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import pytest
from psutil import Process

from armimp_bringup.graph import DomainClaim
from armimp_bringup.nodes import NODES
from armimp_estimation.summary import read_summary
from support.command import program
from support.graph import CHOICES
from support.processes import wait_until
from support.runs import FinishedRun, Run

pytestmark = pytest.mark.slow

PATIENCE = 120.0


def start(
    directory: Path, *options: str, **choices: str
) -> AbstractContextManager["subprocess.Popen[str]"]:
    """An experiment in a process of its own, with no discovery settings but these."""
    environment = {name: value for name, value in os.environ.items() if name not in CHOICES}
    arguments = ["run", "--duration", "10", "--json", "--out", str(directory), *options]
    return program(*arguments, stdout=subprocess.PIPE, env=environment | choices)


def test_two_experiments_at_once_do_not_hear_each_other(
    tmp_path: Path, composed: FinishedRun, run: Run
) -> None:
    """Every message of each is the same, to the last bit, as when it is alone on the machine."""
    alone = {1: composed, 2: run(seed=2)}
    processes = {1: "composed", 2: "separate"}
    with ExitStack() as stack:
        others = {}
        for seed, how in processes.items():
            options = ("--seed", str(seed), "--processes", how, "--duration", "2")
            others[seed] = stack.enter_context(start(tmp_path / str(seed), *options))
        for seed, process in others.items():
            output, errors = process.communicate(timeout=PATIENCE)
            assert process.returncode == 0, errors
            summary = read_summary(tmp_path / str(seed) / "summary.json")
            assert json.loads(output)["problems"] == summary.problems == []
            together = FinishedRun(directory=tmp_path / str(seed), summary=summary)
            together.assert_same_streams(alone[seed])


def test_when_the_domain_is_taken_expect_the_second_experiment_refused(tmp_path: Path) -> None:
    with (
        DomainClaim() as claim,
        start(tmp_path / "out", "--domain-id", str(claim.domain_id)) as second,
    ):
        output, errors = second.communicate(timeout=PATIENCE)

    assert second.returncode == 1
    assert output == ""
    taken = f"armimp: domain id {claim.domain_id} is taken by another experiment"
    assert errors.splitlines() == [taken]
    assert not (tmp_path / "out").exists()


def graph_of(process: "subprocess.Popen[str]", directory: Path) -> dict[int, set[Any]]:
    """Processes of an experiment that has begun its first trial, each with its addresses."""

    def begun() -> bool:
        assert process.poll() is None, process.communicate()
        return any(directory.glob("bags/*/*.mcap"))

    wait_until(begun, "the first trial")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return {
        number: {one.laddr for one in Process(number).net_connections() if one.laddr}
        for number in (process.pid, *map(int, children))
    }


@pytest.mark.parametrize("processes", ["composed", "separate"])
def test_nothing_of_an_experiment_can_be_reached_from_other_machines(
    tmp_path: Path, processes: str
) -> None:
    """Sockets that are bound to the loopback interface hear no other machine."""
    with start(tmp_path / "out", "--processes", processes) as experiment:
        graph = graph_of(experiment, tmp_path / "out")
        experiment.terminate()
        experiment.communicate(timeout=PATIENCE)

    assert len(graph) == (1 if processes == "composed" else 1 + len(NODES))
    # Each has two ports at least, for discovery and for data.
    assert all(len(found) >= 2 for found in graph.values())
    assert all(ip_address(one.ip).is_loopback for found in graph.values() for one in found)
