"""The workspace builds, installs and tests with colcon, as in a full ROS 2 installation."""

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from rclpy.node import Node

from armimp_common.executor import Spinner
from armimp_common.lifecycle import LifecycleManager
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE
from support.graph import PATIENCE

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = (ROOT / "ros2_ws" / "src", ROOT / "examples")
SOURCES = {path.parent.name: path.parent for one in FOLDERS for path in one.glob("*/package.xml")}
PACKAGES = sorted(SOURCES)
EXECUTABLES = {
    "armimp": [],
    "armimp_bringup": ["armimp"],
    "armimp_common": [],
    "armimp_control": [CONTROLLER_NODE],
    "armimp_driver_template": ["exo_driver"],
    "armimp_estimation": [ESTIMATOR_NODE],
    "armimp_ros2_control": ["ros2_control_bridge"],
    "armimp_sim": [SIM_NODE],
}
SHARED = ("config", "layouts", "urdf")


@dataclass(frozen=True)
class Workspace:
    """A workspace that colcon has built."""

    root: Path

    @property
    def install(self) -> Path:
        return self.root / "install"

    def share(self, package: str) -> Path:
        return self.install / package / "share" / package

    def colcon(self, verb: str, *arguments: str) -> None:
        """Run colcon, whose products stay out of the sources."""
        # By the module, so that the interpreter of this test becomes that of the executables.
        command = [sys.executable, "-m", "colcon", "--log-base", str(self.root / "log"), verb]
        command += ["--base-paths", *map(str, FOLDERS), "--build-base", str(self.root / "build")]
        if verb in ("build", "test"):
            command += ["--install-base", str(self.install)]
        done = subprocess.run(
            [*command, *arguments], capture_output=True, text=True, cwd=self.root, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    built = Workspace(tmp_path_factory.mktemp("ws"))
    built.colcon("build")
    return built


def content(folder: Path) -> dict[Path, bytes]:
    """Files by their path, without what Python has compiled."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_is_installed_where_ros_looks(workspace: Workspace, package: str) -> None:
    prefix = workspace.install / package
    assert (prefix / "share/ament_index/resource_index/packages" / package).is_file()
    assert (workspace.share(package) / "package.xml").is_file()
    executables = prefix / "lib" / package
    found = sorted(path.name for path in executables.iterdir()) if executables.exists() else []
    assert found == EXECUTABLES[package]
    (modules,) = (prefix / "lib").glob("python*/site-packages")
    for folder, installed in (
        (package, modules / package),
        *((one, workspace.share(package) / one) for one in SHARED),
    ):
        assert content(installed) == content(SOURCES[package] / folder)


def test_an_installed_node_takes_part_in_the_graph(workspace: Workspace, node: Node) -> None:
    executable = workspace.install / "armimp_sim" / "lib" / "armimp_sim" / SIM_NODE
    parameters = workspace.share("armimp_sim") / "config" / f"{SIM_NODE}.yaml"
    node_command = [str(executable), "--ros-args", "--params-file", str(parameters)]
    sourced = 'source "$0" && exec "$@"'
    process = subprocess.Popen(
        ["bash", "-c", sourced, str(workspace.install / "setup.bash"), *node_command],
        # Somebody who has no other way to the packages than the workspace.
        env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        with Spinner([node]) as spinner:
            manager = LifecycleManager(
                node, [SIM_NODE], spin_until=spinner.spin_until, timeout=PATIENCE
            )
            manager.wait_for_nodes()
            state = manager.state(SIM_NODE)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.wait()
    assert state == "unconfigured"
    assert process.returncode == 0, said
