"""The layout of the workspace: mathematics apart from ROS, imports as page and manifests say."""

import ast
import re
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path
from xml.etree import ElementTree

import pytest

from support.places import PACKAGES, ROOT, SOURCES
from support.processes import run_python

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
ROWS = dict(re.findall(r"^\| `(armimp\w*)` \| [^|]+ \| ([^|]+) \|$", PAGE, flags=re.MULTILINE))
ALLOWED = {package: set(re.findall(r"`(\w+)`", cell)) for package, cell in ROWS.items()}
"""What each package may import of the others, as the architecture page says."""
ROS = {
    *("rclpy", "builtin_interfaces", "diagnostic_msgs", "lifecycle_msgs", "rcl_interfaces"),
    *("rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs"),
}

WITH_ROS = {
    *("armimp_control.node", "armimp_driver_template.node", "armimp_estimation.node"),
    *("armimp_ros2_control.node", "armimp_sim.node", "armimp_common.pubsub"),
    *("armimp_common.lifecycle", "armimp_common.heartbeat", "armimp_common.parameters"),
    *("armimp_common.qos", "armimp_common.driver_base", "armimp_common.executor"),
    *("armimp_bringup.driver_check.checker", "armimp_bringup.driver_check.command"),
    *("armimp_bringup.driver_check.conversation", "armimp_bringup.graph"),
    *("armimp_bringup.orchestrator", "armimp_bringup.nodes", "armimp_bringup.replay"),
}
"""Every other module must work where there is no ROS at all."""


def modules(package: str) -> Iterator[tuple[str, Path]]:
    root = SOURCES[package]
    for path in sorted((root / package).rglob("*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts)
        yield name.removesuffix(".__init__"), path


def arrows() -> dict[str, set[str]]:
    """Modules of this project that each module imports, for types alone included."""
    files = {name: path for package in PACKAGES for name, path in modules(package)}
    for folder in ("research", "benchmarks"):
        for path in (ROOT / folder).glob("*.py"):
            files[f"{folder}.{path.stem}"] = path
    found: dict[str, set[str]] = {}
    for name, path in files.items():
        found[name] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                names = {f"{node.module}.{alias.name}" for alias in node.names}
                found[name] |= {one if one in files else node.module for one in names}
        found[name] &= files.keys() - {name}
    return found


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert list(TopologicalSorter(arrows()).static_order())


def imported(path: Path) -> set[str]:
    """Top-level packages that a file imports anywhere."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return found


def test_modules_without_ros_can_be_imported_where_there_is_none() -> None:
    everything = [name for package in PACKAGES for name, _ in modules(package)]
    names = [name for name in everything if name not in WITH_ROS]
    assert len(names) > 100
    program = (
        "import importlib, sys\n"
        f"for name in {sorted(ROS)!r}: sys.modules[name] = None\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
    )
    run_python("-c", program)


def test_the_architecture_page_names_every_package_and_no_circle_of_them() -> None:
    assert sorted(ALLOWED) == PACKAGES
    assert list(TopologicalSorter(ALLOWED).static_order())


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_and_declares_what_the_architecture_page_lets_it(package: str) -> None:
    manifest = ElementTree.parse(SOURCES[package] / "package.xml").getroot()
    declared = {one.text for kind in ("depend", "exec_depend") for one in manifest.iter(kind)}
    used = set().union(*(imported(path) for _, path in modules(package))) - {package}
    assert used & set(PACKAGES) == declared & set(PACKAGES) == ALLOWED[package]
    assert used & ROS <= declared


def test_the_wheel_depends_on_whatever_it_imports() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = project.partition("dependencies = [")[2].partition("]")[0]
    used = set().union(*(imported(path) for one in PACKAGES for _, path in modules(one)))
    used -= {*PACKAGES, *ROS, *sys.stdlib_module_names}
    provided = packages_distributions()
    used -= {"llvmlite", "markupsafe"}  # parts of numba and Jinja2
    names = {provided[name][0].lower().replace("_", "-") for name in used}
    assert names == set(re.findall(r'"([\w-]+)', listed))


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_that_is_installed_imports_pytest_or_the_workshop(package: str) -> None:
    workshop = {"pytest", "support", "research", "benchmarks"}
    assert not {name for name, path in modules(package) if imported(path) & workshop}
