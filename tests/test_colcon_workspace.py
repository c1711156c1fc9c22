"""The workspace builds and installs with colcon, as in a full ROS 2 installation."""

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
from rclpy.node import Node

from armimp_common.executor import Spinner
from armimp_common.lifecycle import LifecycleManager
from armimp_common.topics import SIM_NODE
from support.graph import PATIENCE
from support.places import PACKAGES, SOURCES, contents
from support.processes import run_python

pytestmark = pytest.mark.slow

SHARED = ("config", "layouts", "urdf")


@pytest.fixture(scope="module")
def install(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where colcon has installed the workspace; its products stay out of the sources."""
    root = tmp_path_factory.mktemp("ws")
    places = ["--build-base", str(root / "build"), "--install-base", str(root / "install")]
    # By the module, so that the interpreter of this test becomes that of the executables.
    command = ["-m", "colcon", "--log-base", str(root / "log"), "build", *places]
    run_python(*command, "--base-paths", *map(str, SOURCES.values()), cwd=root)
    return root / "install"


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_is_installed_where_ros_looks(install: Path, package: str) -> None:
    prefix, source = install / package, SOURCES[package]
    share = prefix / "share" / package
    assert (prefix / "share/ament_index/resource_index/packages" / package).is_file()
    assert (share / "package.xml").is_file()
    setup = (source / "setup.cfg").read_text(encoding="utf-8").partition("console_scripts =")[2]
    executables = prefix / "lib" / package
    found = {path.name for path in executables.iterdir()} if executables.exists() else set()
    assert found == set(re.findall(r"^    (\w+) = ", setup, flags=re.MULTILINE))
    (modules,) = (prefix / "lib").glob("python*/site-packages")
    assert contents(modules / package) == contents(source / package)
    for folder in SHARED:
        assert contents(share / folder) == contents(source / folder)


def test_an_installed_node_takes_part_in_the_graph(install: Path, node: Node) -> None:
    prefix = install / "armimp_sim"
    parameters = prefix / "share" / "armimp_sim" / "config" / f"{SIM_NODE}.yaml"
    executable = prefix / "lib" / "armimp_sim" / SIM_NODE
    node_command = [str(executable), "--ros-args", "--params-file", str(parameters)]
    sourced = 'source "$0" && exec "$@"'
    process = subprocess.Popen(
        ["bash", "-c", sourced, str(install / "setup.bash"), *node_command],
        # A user who has no other way to the packages than the workspace.
        env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        with Spinner([node]) as spinner:
            manager = LifecycleManager(node, [SIM_NODE], spinner=spinner, timeout=PATIENCE)
            manager.wait_for_nodes()
            state = manager.state(SIM_NODE)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.wait()
    assert state == "unconfigured"
    assert process.returncode == 0, said
