"""Experiments that several tests look at, each run once."""

import fcntl
import functools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from armimp_bringup.config import CheckOptions, ExperimentConfig
from armimp_bringup.driver_check import Finding
from armimp_bringup.driver_check.checker import probe
from armimp_bringup.driver_check.rules import judge
from armimp_bringup.nodes import MODULES
from armimp_bringup.orchestrator import run_experiment
from armimp_estimation.summary import SUMMARY_FILE, read_summary
from support.graph import PATIENCE, free_domain, hosted
from support.places import SOURCES
from support.runs import FinishedRun, Run


@pytest.fixture(scope="session")
def environment() -> Iterator[None]:
    """Restore the environment variables: a graph leaves its domain id in them."""
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


@pytest.fixture(scope="session")
def run(environment: None, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Run a short experiment, or reuse that of a worker which asked for the same options."""
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def run_once(**options: Any) -> FinishedRun:
        config = ExperimentConfig.model_validate({"duration": 2.0, **options})
        directory = base / "-".join(["shared", *(f"{k}={v}" for k, v in options.items())])
        with (base / f"{directory.name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (directory / SUMMARY_FILE).exists():
                run_experiment(config, directory)
        return FinishedRun(directory=directory, summary=read_summary(directory / SUMMARY_FILE))

    return run_once


@pytest.fixture(scope="session")
def composed(run: Run) -> FinishedRun:
    """The default experiment, but short, in one process."""
    return run()


@pytest.fixture
def driver_domain(environment: None, monkeypatch: pytest.MonkeyPatch) -> int:
    """A free domain id, which the driver check claims, not the test."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    return domain_id


@pytest.fixture
def start(driver_domain: int) -> Iterator[Callable[..., "subprocess.Popen[bytes]"]]:
    """Start nodes in processes of their own, as another user would."""
    variables = {**os.environ}
    variables.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    processes: list[subprocess.Popen[bytes]] = []

    def run(arguments: list[str], *ros: str) -> "subprocess.Popen[bytes]":
        # Nodes that others start do not watch their parent: the kernel ends them with the test.
        mortal = ["setpriv", "--pdeathsig", "KILL"]
        command = [*mortal, sys.executable, *arguments, *(["--ros-args", *ros] if ros else [])]
        processes.append(subprocess.Popen(command, env=variables, start_new_session=True))
        return processes[-1]

    yield run
    for process in processes:
        process.send_signal(signal.SIGINT)
    for process in processes:
        try:
            process.wait(30.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@pytest.fixture
def start_node(
    start: Callable[..., "subprocess.Popen[bytes]"],
) -> Callable[[str], "subprocess.Popen[bytes]"]:
    """Start a node with its default parameter file."""

    def run(name: str) -> "subprocess.Popen[bytes]":
        (module,) = MODULES[name]
        parameters = SOURCES[module.partition(".")[0]] / "config" / f"{name}.yaml"
        return start(["-m", module], "--params-file", str(parameters))

    return run


@pytest.fixture
def host(driver_domain: int) -> Iterator[Callable[..., None]]:
    """Run nodes in threads of the test, which is quicker than starting processes."""
    with ExitStack() as stack:

        def run(make: Callable[..., Node], **parameters: Any) -> None:
            overrides = [Parameter(k.replace("__", "."), value=v) for k, v in parameters.items()]
            made = functools.partial(make, parameter_overrides=overrides)
            stack.enter_context(hosted(lambda context: made(context=context), driver_domain))

        yield run


@pytest.fixture
def check(driver_domain: int, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Finding]]:
    """Judge the running driver; return its findings by the name of each check."""
    # How quickly a service answers or a fault is reported depends on the machine as well.
    for limit in ("_ANSWER", "_REPORT"):
        monkeypatch.setattr(f"armimp_bringup.driver_check.rules.{limit}", PATIENCE)

    def run(**options: Any) -> dict[str, Finding]:
        given = {"joints": ("shoulder", "elbow"), "duration": 1.0, **options}
        found = judge(probe(CheckOptions(**given), driver_domain))
        return {finding.check: finding for finding in found}

    return run
