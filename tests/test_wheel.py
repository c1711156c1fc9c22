"""The one wheel of the project works where there is no ROS, by the lines of the README."""

import os
import re
import subprocess
import sys
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import armimp
from support.places import ROOT, SOURCES
from support.processes import run_program

PACKAGES = [one for one, path in sorted(SOURCES.items()) if path.parent.name == "src"]


def test_the_project_has_the_packages_versions_and_commands_of_the_workspace() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    setups = {one: (SOURCES[one] / "setup.cfg").read_text(encoding="utf-8") for one in PACKAGES}
    where = re.findall(r'^    "ros2_ws/src/(\w+)",$', project, flags=re.MULTILINE)
    assert sorted(where) == PACKAGES
    version, *_ = re.findall(r'^version = "(.+)"$', project, flags=re.MULTILINE)
    assert all(f"version = {version}\n" in text for text in setups.values())
    scripts = re.findall(r"console_scripts =\n    (\w+) = ([\w.:]+)", "".join(setups.values()))
    assert len(scripts) == 5
    assert {f'{name} = "{function}"' for name, function in scripts} <= set(project.splitlines())
    pins = re.findall(r'^    "(ros-.+)",$', project, flags=re.MULTILINE)
    locked = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    assert pins
    assert all(pin in locked for pin in pins)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_wheel_identifies_an_arm_in_an_empty_environment(tmp_path: Path) -> None:
    trials = armimp.simulate(duration=20.0, seed=1).trials
    arrays: dict[str, Any] = {
        name: np.stack([getattr(one, name) for one in trials])
        for name in ("perturbation", "position", "torque")
    }
    np.savez(tmp_path / "recording.npz", **arrays)
    environment = dict(os.environ)
    for name in ("PYTHONPATH", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"):
        environment.pop(name, None)
    run = partial(run_program, cwd=tmp_path, env=environment)
    checkout = tmp_path / "checkout"
    run("git", "clone", "--quiet", str(ROOT), str(checkout))
    pip = [sys.executable, "-m", "pip", "-qq", "wheel", "--no-deps", "--no-build-isolation"]
    run(*pip, "--wheel-dir", str(tmp_path), str(checkout))
    (wheel,) = tmp_path.glob("armimp-*.whl")
    with zipfile.ZipFile(wheel) as file:
        assert {name.split("/")[0] for name in file.namelist()} >= set(PACKAGES)
    run(sys.executable, "-m", "venv", "empty")
    python = str(tmp_path / "empty" / "bin" / "python")
    run(python, "-m", "pip", "-qq", "install", str(wheel))

    assert "rclpy" not in run(python, "-m", "pip", "list")
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"^```python\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    assert run(python, "-c", program).splitlines()[-1] == "valid"
    command = [str(tmp_path / "empty" / "bin" / "armimp"), "run"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "armimp: this needs ROS, which is not installed: pip install 'armimp[ros]'"
    ]
