"""Experiments that several tests look at, each run once."""

import os
import shutil
from collections.abc import Iterator
from typing import Any

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from armimp_bringup.testing import FinishedRun, Run
from armimp_common.fault_figures import figures, pytest_terminal_summary
from armimp_common.testing import context, domain_id, interruptible, node
from armimp_estimation.report.browser import Browser

__all__ = ["context", "domain_id", "figures", "interruptible", "node", "pytest_terminal_summary"]


@pytest.fixture(scope="session")
def environment() -> Iterator[None]:
    """Give the environment back as it was: a graph leaves its domain in it."""
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


@pytest.fixture(scope="session")
def run(environment: None, tmp_path_factory: pytest.TempPathFactory) -> Run:
    def run_short(**options: Any) -> FinishedRun:
        config = ExperimentConfig.model_validate({"duration": 10.0, **options})
        directory = tmp_path_factory.mktemp("run") / "out"
        return FinishedRun(directory=directory, summary=run_experiment(config, directory))

    return run_short


@pytest.fixture(scope="session")
def composed(run: Run) -> FinishedRun:
    """The default experiment, but short, in one process."""
    return run()


@pytest.fixture(scope="session")
def separate(run: Run) -> FinishedRun:
    """The same in one process for each node."""
    return run(processes="separate")


@pytest.fixture(scope="session")
def other_seed(run: Run) -> FinishedRun:
    """The default experiment, but short, with another seed."""
    return run(seed=2)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A headless browser to look at reports with."""
    executable = shutil.which("chromium")
    if executable is None:
        pytest.skip("there is no chromium to look at the report with (apt-get install chromium)")
    started = Browser(executable, tmp_path_factory.mktemp("profile"))
    yield started
    started.close()
